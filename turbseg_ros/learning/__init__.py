"""Networks: what they see, how they are trained and how they run. Imported only when chosen."""
