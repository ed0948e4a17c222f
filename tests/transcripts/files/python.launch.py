import os

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.conditions import IfCondition, UnlessCondition
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import ComposableNodeContainer, Node
from launch_ros.descriptions import ComposableNode


def generate_launch_description():
    share = get_package_share_directory("my_robot")
    points = LaunchConfiguration("points")
    composed = LaunchConfiguration("composed")
    container = ComposableNodeContainer(
        name="box",
        namespace="",
        package="rclcpp_components",
        executable="component_container",
        condition=IfCondition(composed),
        composable_node_descriptions=[
            ComposableNode(
                package="pointcloud_to_laserscan",
                plugin="pointcloud_to_laserscan::PointCloudToLaserScanNode",
                name="scanner",
                namespace="rear",
                remappings=[("cloud_in", points)],
                parameters=[
                    {
                        "min_height": -0.3,
                        "range_max": 10.0,
                    }
                ],
            ),
        ],
    )
    alone = Node(
        package="pointcloud_to_laserscan",
        executable="pointcloud_to_laserscan_node",
        name="scanner",
        namespace="front",
        remappings=[("cloud_in", points), ("scan", "flat")],
        parameters=[
            os.path.join(share, "sector.yaml"),
            {"min_height": -0.3, "reliability": "best_effort", "use_sim_time": True},
        ],
        condition=UnlessCondition(composed),
    )
    return LaunchDescription(
        [
            DeclareLaunchArgument("points"),
            DeclareLaunchArgument("composed", default_value="false"),
            Node(package="rviz2", executable="rviz2", parameters=[{"x": unknown()}]),
            container,
            alone,
        ]
    )
