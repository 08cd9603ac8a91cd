# The node of examples/ros2 in ROS 2 Jazzy (Ubuntu 24.04, Python 3.12). Nobody has built or run this image yet.
# docker build -f docker/ros2.Dockerfile -t fastsplat/ros2 .
# docker run --network host -e FASTSPLAT_KEY=... fastsplat/ros2 scene:=SCENE server:=http://host:8000
#
# Versions of Ubuntu's and ROS's packages are not pinned (DL3008): their mirrors drop a version when the next one comes.
FROM ros:jazzy-ros-base
SHELL ["/bin/bash", "-o", "pipefail", "-c"]
# hadolint ignore=DL3008
RUN apt-get update \
 && apt-get install --yes --no-install-recommends python3-numpy python3-venv python3-yaml ros-jazzy-vision-msgs \
 && rm -rf /var/lib/apt/lists/* \
 && useradd --uid 10001 --create-home --shell /usr/sbin/nologin fastsplat

# The client needs newer packages (protobuf, pydantic) than Ubuntu has, and Ubuntu's numpy, for which ROS's messages are
# compiled. So they lie in an environment that sees Ubuntu's packages, and ROS's Python finds them before its own.
COPY client /src/client
RUN python3 -m venv --system-site-packages /opt/fastsplat \
 && /opt/fastsplat/bin/pip install --no-cache-dir /src/client
ENV PYTHONPATH=/opt/fastsplat/lib/python3.12/site-packages
COPY examples/ros2 /src/ros2
WORKDIR /src/ros2
RUN . /opt/ros/jazzy/setup.bash \
 && colcon build --install-base /opt/fastsplat_ros2 --merge-install \
 && rm -rf build log

USER 10001:10001
ENTRYPOINT ["/bin/bash", "-c", "source /opt/fastsplat_ros2/setup.bash && exec ros2 launch fastsplat_ros2 scene.launch.py \"$@\"", "ros2"]
