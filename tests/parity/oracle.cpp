// What tf2, tf2_sensor_msgs and laser_geometry themselves return. Reads commands from standard input, one a line, and
// answers each with a line; numbers are C99's hexadecimal ones, so that every bit survives.
//
//   T parent child sec nsec tx ty tz qx qy qz qw static              -> nothing; - is a name without letters
//   L target source sec nsec                                         -> sec nsec tx ty tz qx qy qz qw, or ! and the error
//   F target sec nsec source sec nsec fixed                          -> the same, of the lookup with two times
//   C target source sec nsec x y z x y z ...                         -> the points as tf2_sensor_msgs transforms them
//   S target deskew sec nsec seq angle_min angle_increment time_increment range_min range_max r r r ...
//                                                                    -> seq sec nsec, then the cloud's bytes
//
// Built by test_debian.py against Debian's ROS packages.

#include <cstdio>
#include <cstdlib>
#include <exception>
#include <iostream>
#include <sstream>
#include <string>
#include <vector>

#include <laser_geometry/laser_geometry.h>
#include <tf2/buffer_core.h>
#include <tf2_sensor_msgs/tf2_sensor_msgs.h>

namespace {

double number(std::istream &from) {
    std::string word;
    from >> word;
    return std::strtod(word.c_str(), nullptr);
}

ros::Time stamp(std::istream &from) {
    uint32_t sec, nsec;
    from >> sec >> nsec;
    return ros::Time(sec, nsec);
}

void print_bytes(const std::vector<uint8_t> &bytes) {
    for (uint8_t byte : bytes) std::printf("%02x", byte);
}

void set_transform(std::istream &from, tf2::BufferCore &buffer) {
    geometry_msgs::TransformStamped given;
    int is_static;
    for (std::string *name : {&given.header.frame_id, &given.child_frame_id})
        if (from >> *name; *name == "-") name->clear();
    given.header.stamp = stamp(from);
    auto &translation = given.transform.translation;
    auto &rotation = given.transform.rotation;
    for (double *part : {&translation.x, &translation.y, &translation.z}) *part = number(from);
    for (double *part : {&rotation.x, &rotation.y, &rotation.z, &rotation.w}) *part = number(from);
    from >> is_static;
    buffer.setTransform(given, "oracle", is_static != 0);
}

geometry_msgs::TransformStamped look_up(std::istream &from, tf2::BufferCore &buffer) {
    std::string target, source;
    from >> target >> source;
    return buffer.lookupTransform(target, source, stamp(from));
}

geometry_msgs::TransformStamped look_up_through(std::istream &from, tf2::BufferCore &buffer) {
    std::string target, source, fixed;
    from >> target;
    const ros::Time target_time = stamp(from);
    from >> source;
    const ros::Time source_time = stamp(from);
    from >> fixed;
    return buffer.lookupTransform(target, target_time, source, source_time, fixed);
}

void show_transform(const geometry_msgs::TransformStamped &found) {
    const auto &t = found.transform.translation;
    const auto &q = found.transform.rotation;
    std::printf("%u %u %a %a %a %a %a %a %a", found.header.stamp.sec, found.header.stamp.nsec, t.x, t.y, t.z, q.x, q.y, q.z,
                q.w);
}

void transform_cloud(std::istream &from, tf2::BufferCore &buffer) {
    const geometry_msgs::TransformStamped transform = look_up(from, buffer);
    std::vector<float> values;
    for (std::string word; from >> word;) values.push_back(std::strtof(word.c_str(), nullptr));
    sensor_msgs::PointCloud2 cloud, moved;
    sensor_msgs::PointCloud2Modifier modifier(cloud);
    modifier.setPointCloud2Fields(3, "x", 1, sensor_msgs::PointField::FLOAT32, "y", 1, sensor_msgs::PointField::FLOAT32,
                                  "z", 1, sensor_msgs::PointField::FLOAT32);
    modifier.resize(values.size() / 3);
    std::memcpy(cloud.data.data(), values.data(), cloud.data.size());
    tf2::doTransform(cloud, moved, transform);
    print_bytes(moved.data);
}

void project_scan(std::istream &from, tf2::BufferCore &buffer) {
    std::string target;
    int deskew;
    sensor_msgs::LaserScan scan;
    from >> target >> deskew;
    scan.header.frame_id = "laser";
    scan.header.stamp = stamp(from);
    from >> scan.header.seq;
    for (float *part : {&scan.angle_min, &scan.angle_increment, &scan.time_increment, &scan.range_min, &scan.range_max})
        *part = static_cast<float>(number(from));
    for (std::string word; from >> word;) scan.ranges.push_back(std::strtof(word.c_str(), nullptr));
    scan.angle_max = scan.angle_min + scan.angle_increment * (scan.ranges.size() - 1);
    laser_geometry::LaserProjection projection;
    sensor_msgs::PointCloud2 cloud;
    if (deskew) {
        projection.transformLaserScanToPointCloud(target, scan, cloud, buffer);
    } else {
        projection.projectLaser(scan, cloud);
        if (target != "laser") {
            const sensor_msgs::PointCloud2 own = cloud;
            tf2::doTransform(own, cloud, buffer.lookupTransform(target, "laser", scan.header.stamp));
        }
    }
    std::printf("%u %u %u ", cloud.header.seq, cloud.header.stamp.sec, cloud.header.stamp.nsec);
    print_bytes(cloud.data);
}

}  // namespace

int main() {
    tf2::BufferCore buffer(ros::Duration(2000000000));
    for (std::string line; std::getline(std::cin, line);) {
        std::istringstream words(line);
        std::string command;
        words >> command;
        if (command == "T") {
            set_transform(words, buffer);
            continue;
        }
        try {
            if (command == "L") show_transform(look_up(words, buffer));
            if (command == "F") show_transform(look_up_through(words, buffer));
            if (command == "C") transform_cloud(words, buffer);
            if (command == "S") project_scan(words, buffer);
        } catch (const std::exception &error) {
            const std::string what = error.what();
            std::printf("! %s", what.substr(0, what.find('\n')).c_str());
        }
        std::printf("\n");
    }
}
