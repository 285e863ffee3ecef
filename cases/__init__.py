"""Scenes, three-way comparison, report and command line."""
