"""Kinds of relations between keypoints, one file each; every module in this folder is found."""
