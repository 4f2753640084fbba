"""The live nodes: what needs rclpy's middleware."""
