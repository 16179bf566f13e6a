"""Simulations that use ``warp_bounding`` as their broad phase, through its public API only.

A folder a demo, which ``python -m sims NAME`` runs: an ``Example``, one run of the simulation, and a ``Demo``, which
runs it with and without bounders (``base`` has what all of them share). ``prefitted`` has the bounders that they load,
``report`` what they print, ``drawing`` is what its name says.
"""

DEMOS = ("particles", "cloth", "path", "shadows", "digits", "arm", "pile")
