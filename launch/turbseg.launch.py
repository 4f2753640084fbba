"""One camera: `ros2 launch turbseg_ros turbseg.launch.py namespace:=/north image:=image_raw`."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare


def generate_launch_description() -> LaunchDescription:
    """Return the node, with its arguments declared."""
    presets = PathJoinSubstitution([FindPackageShare("turbseg_ros"), "config"])
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                "namespace", default_value="", description="Namespace of the node and its topics."
            ),
            DeclareLaunchArgument(
                "image",
                default_value="image_raw",
                description="Image topic, without /compressed; relative to the namespace.",
            ),
            DeclareLaunchArgument(
                "camera_info",
                default_value="camera_info",
                description="CameraInfo topic of the same camera, if there is one; by default "
                "that beside the image topic.",
            ),
            DeclareLaunchArgument(
                "params_file",
                default_value=PathJoinSubstitution([presets, "live.yaml"]),
                description="ROS parameter file.",
            ),
            DeclareLaunchArgument(
                "use_sim_time", default_value="false", description="Take the time from /clock."
            ),
            Node(
                package="turbseg_ros",
                executable="turbseg_node",
                namespace=LaunchConfiguration("namespace"),
                remappings=[
                    ("image_raw", LaunchConfiguration("image")),
                    ("camera_info", LaunchConfiguration("camera_info")),
                ],
                parameters=[
                    LaunchConfiguration("params_file"),
                    {"use_sim_time": LaunchConfiguration("use_sim_time")},
                ],
                output="screen",
            ),
        ]
    )
