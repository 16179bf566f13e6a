"""Shapes that formulas describe: functions of any number of coordinates, and an algebra of solids."""
