"""Simulations that use ``warp_bounding`` as their broad phase, through its public API only.

A folder a demo: an ``Example`` class with ``step``, ``render`` and ``test_final``, and ``run``, the whole demo, which ``warp-bounding demo NAME``
calls. ``prefitted`` has the bounders that they load, ``report`` what they print, ``drawing`` and ``cores`` are what their names say.
"""
