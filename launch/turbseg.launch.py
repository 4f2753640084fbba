"""One camera: `ros2 launch turbseg_ros turbseg.launch.py namespace:=/north image:=image_raw`.

`ros2 launch turbseg_ros turbseg.launch.py --show-args` lists the arguments.
"""

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare

# Arguments that set a parameter where they are given, after the parameter file.
_PARAMETERS = {
    "transport": ("image_transport", "raw or compressed."),
    "regions": ("regions.file", "File of regions to ignore, or to look for objects in."),
}


def generate_launch_description() -> LaunchDescription:
    """Return the arguments and, once they are known, the node."""
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
                "preset",
                default_value="live",
                description="Parameter file of the package, by name: low_latency, "
                "more_look_ahead, severe, thermal, no_refine.",
            ),
            DeclareLaunchArgument(
                "params_file",
                default_value=[
                    FindPackageShare("turbseg_ros"),
                    "/config/",
                    LaunchConfiguration("preset"),
                    ".yaml",
                ],
                description="ROS parameter file, instead of a preset.",
            ),
            *(
                DeclareLaunchArgument(name, default_value="", description=description)
                for name, (_, description) in _PARAMETERS.items()
            ),
            DeclareLaunchArgument(
                "log_level", default_value="info", description="debug, info, warn or error."
            ),
            DeclareLaunchArgument(
                "use_sim_time", default_value="false", description="Take the time from /clock."
            ),
            OpaqueFunction(function=_node),
        ]
    )


def _node(context: LaunchContext) -> list[Node]:
    given = {
        parameter: value
        for name, (parameter, _) in _PARAMETERS.items()
        if (value := LaunchConfiguration(name).perform(context))
    }
    return [
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
                {"use_sim_time": LaunchConfiguration("use_sim_time"), **given},
            ],
            ros_arguments=["--log-level", LaunchConfiguration("log_level")],
            output="screen",
        )
    ]
