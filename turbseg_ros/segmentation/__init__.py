"""The method: numpy and OpenCV; no ROS, no files, no torch."""
