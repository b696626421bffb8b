"""What several test modules share: models, files as text, tables and comparisons."""
