"""Results for people to keep: films and tables of objects."""
