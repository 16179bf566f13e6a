"""What a worker process of this machine does when it starts, and again when it is started anew; Dask calls ``dask_setup``."""

import os
import signal

__all__ = ["dask_setup"]


def dask_setup(worker: object) -> None:
    """Leave Ctrl-C to the client, which ends the workers, and standard output to its ``--json``."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.dup2(2, 1)
