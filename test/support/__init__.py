"""What several tests draw, start or stand in for."""
