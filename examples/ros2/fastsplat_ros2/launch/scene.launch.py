"""`ros2 launch fastsplat_ros2 scene.launch.py scene:=SCENE`; the key comes from FASTSPLAT_KEY."""

from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from launch import LaunchDescription

_ARGUMENTS = {
    "scene": ("", "id of the scene"),
    "server": ("http://127.0.0.1:8000", "address of the server"),
    "period": ("5.0", "seconds between two looks for a newer version of the scene"),
}


def generate_launch_description() -> LaunchDescription:
    """The node `fastsplat`, with its parameters as arguments."""
    return LaunchDescription(
        [
            *(
                DeclareLaunchArgument(name, default_value=value, description=text)
                for name, (value, text) in _ARGUMENTS.items()
            ),
            Node(
                package="fastsplat_ros2",
                executable="scene",
                name="fastsplat",
                output="screen",
                parameters=[{name: LaunchConfiguration(name) for name in _ARGUMENTS}],
            ),
        ]
    )
