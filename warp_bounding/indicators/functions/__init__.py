"""Shapes that formulas describe: functions of any number of dimensions, and an algebra of solids with certified bounds."""
