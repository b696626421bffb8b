"""Shared by several test modules: models, files as text, tables and comparisons."""
