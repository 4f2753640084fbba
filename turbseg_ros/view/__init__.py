"""What is seen of a running node in a browser: its state, the ROS side, the server, the page."""
