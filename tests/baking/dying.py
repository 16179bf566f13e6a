"""Settings of a bake under which workers die, as when somebody kills them; workers import them from here."""

import os
import signal
from dataclasses import dataclass
from pathlib import Path

from warp_bounding.baking import Settings


@dataclass(frozen=True)
class DyingSettings(Settings):
    """The worker dies under the first shape that it fits, and under every shape that is called ``deadly``."""

    mark: str = ""

    def bounder(self, shape):
        if shape != "." and (not Path(self.mark).exists() or "deadly" in shape.name):  # else it is a check of options
            Path(self.mark).touch()
            os.kill(os.getpid(), signal.SIGKILL)
        return super().bounder(shape)
