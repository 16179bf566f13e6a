"""Balls and ellipsoids of least size, and the tests of rays, planes and boxes against one."""
