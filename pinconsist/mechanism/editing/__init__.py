"""Mechanisms made from mechanisms: joints locked, what is immobile left out, anchors moved."""
