"""For colcon: `colcon build --packages-select fastsplat_ros2`."""

from setuptools import setup

setup(
    name="fastsplat_ros2",
    version="0.2.0",
    description="A FAST-Splat scene as ROS 2 topics, transforms and a service.",
    license="Apache-2.0",
    packages=["fastsplat_ros2"],
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/fastsplat_ros2"]),
        ("share/fastsplat_ros2", ["package.xml"]),
        ("share/fastsplat_ros2/launch", ["launch/scene.launch.py"]),
    ],
    install_requires=["fastsplat-client", "numpy", "PyYAML"],
    extras_require={"bag": ["rosbags>=0.11,<0.12"]},
    entry_points={
        "console_scripts": ["scene = fastsplat_ros2.node:main", "bag = fastsplat_ros2.bag:main"],
    },
)
