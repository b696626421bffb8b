"""pinconsist."""
