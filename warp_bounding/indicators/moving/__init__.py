"""Triangles that move on straight ways from keyframe to keyframe: how points and boxes of time and space are asked about."""
