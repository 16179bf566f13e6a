"""Simulations that use ``warp_bounding`` as their broad phase, through its public API only.

Each is an ``Example`` class with ``step``, ``render`` and ``test_final``, and a ``run`` function that does the whole
demo; ``warp-bounding demo NAME`` calls it.
"""
