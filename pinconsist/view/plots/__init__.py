"""Figures in one look, legible in grey: lines differ in colour, dash and marker."""
