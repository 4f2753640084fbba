"""Several cameras, a node each: `ros2 launch turbseg_ros cameras.launch.py cameras:=north,south`.

Camera `north` is expected on /north/image_raw and, if calibrated, /north/camera_info; its results
appear below /north/turbseg. Cameras may be on other hosts of the DDS network.
"""

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription, OpaqueFunction
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution, ThisLaunchFileDir


def generate_launch_description() -> LaunchDescription:
    """Return the arguments and, once they are known, the nodes."""
    return LaunchDescription(
        [
            DeclareLaunchArgument("cameras", description="Namespaces of the cameras, by commas."),
            OpaqueFunction(function=_one_node_a_camera),
        ]
    )


def _one_node_a_camera(context: LaunchContext) -> list[IncludeLaunchDescription]:
    cameras = LaunchConfiguration("cameras").perform(context).split(",")
    one_camera = PathJoinSubstitution([ThisLaunchFileDir(), "turbseg.launch.py"])
    return [
        IncludeLaunchDescription(
            PythonLaunchDescriptionSource([one_camera]),
            launch_arguments={"namespace": camera.strip()}.items(),
        )
        for camera in cameras
        if camera.strip()
    ]
