# The node on ROS 2 Jazzy; compose.yaml starts it. docker build -t turbseg_ros .
FROM ros:jazzy-ros-base
COPY . /ws/src/turbseg_ros
WORKDIR /ws
RUN apt-get update && rosdep update && \
    rosdep install --from-paths src --ignore-src -y && \
    rm -rf /var/lib/apt/lists/* && \
    . /opt/ros/jazzy/setup.sh && colcon build --packages-select turbseg_ros
# Not by `ros2 run`, which would keep the signal that ends a container to itself.
ENTRYPOINT ["/bin/bash", "-c", ". install/setup.bash && exec install/turbseg_ros/lib/turbseg_ros/turbseg_node \"$@\"", "turbseg_node"]
