"""Rooms with still objects and a moving camera, rendered by MuJoCo."""
