"""Images and results from and to ROS messages, without middleware."""
