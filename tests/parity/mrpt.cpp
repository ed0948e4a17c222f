// Which range each beam of MRPT takes from a LaserScan.
//
// Input: a line for each scan, "angle_min angle_max beams", the angles as hexadecimal floats.
// Output: a line for each scan, the indexes of the ranges that its beams take.
#include <cstdio>
#include <cstdlib>
#include <iostream>
#include <string>

#include <mrpt/obs/CObservation2DRangeScan.h>
#include <mrpt/poses/CPose3D.h>
#include <mrpt/ros1bridge/laser_scan.h>
#include <sensor_msgs/LaserScan.h>

int main() {
  std::string low, high;
  std::size_t beams;
  while (std::cin >> low >> high >> beams) {
    sensor_msgs::LaserScan scan;
    scan.header.stamp = ros::Time(1700000000, 0);
    scan.angle_min = std::strtof(low.c_str(), nullptr);
    scan.angle_max = std::strtof(high.c_str(), nullptr);
    scan.range_max = 1e9f;
    scan.ranges.resize(beams);
    for (std::size_t i = 0; i < beams; ++i) scan.ranges[i] = i;
    mrpt::obs::CObservation2DRangeScan seen;
    mrpt::ros1bridge::fromROS(scan, mrpt::poses::CPose3D(), seen);
    for (std::size_t i = 0; i < beams; ++i) std::printf("%d ", static_cast<int>(seen.getScanRange(i)));
    std::printf("\n");
  }
}
