"""Twelve mechanisms with looks of their own, each in one file: springs, friction, closed loops, attraction."""
