"""*Convergence*: both errors over training, with the asymmetric loss and with the common one."""

from functools import partial
from typing import Any

from paper.drawing.base import Figure, objects_named
from paper.drawing.canvas import PALE, page
from warp_bounding.activations import DEFAULT

__all__ = ["Convergence"]

HIDDEN = {2: (25, 25), 3: (50, 50)}
STEPS, STAGES, RECORDS = {2: (8_000, 1_600), 3: (6_400, 1_200)}, 8, 64  # steps: full, quick
BATCH = (4096, 2048)
LOSSES = {"asymmetric": ("ours: asymmetric", "#1f6fb4"), "common": ("common: symmetric", "#d62b2b")}
LEAST = 0.003  # per cent; below, the axis is linear


class Convergence(Figure):
    """See module."""

    name = "convergence"
    title = "Both errors over training"
    paper = "the paper's convergence plots"
    caption = (
        "False negatives (solid) and false positives (dotted), in per cent of points, over training steps, for two objects. With the "
        "asymmetric loss (blue; the paper's schedule in small, whose weights change at the vertical lines) false negatives fall to zero and false positives pay "
        "for it; with the common loss (red) both settle at about the same height, and false negatives stay. The axis is logarithmic down to "
        f"{LEAST:g} %, then linear to zero. Zero on a sample is no proof: in 3D a few come back. What is shipped is neither: a proof sets the threshold afterwards."
    )
    objects = objects_named("2d/dragon1=2d/fish 3d/bunny=3d/bunny")

    def parts(self, work):
        def trained(grid, loss: str) -> dict[str, Any]:
            from warp_bounding.training.comparisons.loss_record import record

            full, quick = STEPS[grid.ndim]
            steps = max(STAGES, round(work.choose(full, quick) * work.settings.effort))
            sizes = {"steps": steps, "stage": steps // STAGES, "every": max(1, steps // RECORDS)}
            sizes |= {"batch": work.choose(*BATCH), "seed": work.settings.seed, "note": work.note}
            found = record(grid, HIDDEN[grid.ndim], DEFAULT.name, common=loss == "common", **sizes)
            return {**found, "stage": sizes["stage"]}

        return {
            f"{thing.label} {loss}": partial(trained, work.shape(thing), loss)
            for thing in self.wanted(work.settings)
            for loss in LOSSES
        }

    def draw(self, parts, tools):
        labels = list(dict.fromkeys(name.partition(" ")[0] for name in parts))

        def fill(figure) -> None:
            figure.set_size_inches(9.0, 3.8)
            place = {"left": 0.07, "right": 0.99, "top": 0.92, "bottom": 0.26, "wspace": 0.07}
            panels = figure.subplots(1, len(labels), sharey=True, gridspec_kw=place, squeeze=False)[0]
            for axes, label in zip(panels, labels, strict=True):
                for loss, (told, colour) in LOSSES.items():
                    part = parts[f"{label} {loss}"]
                    axes.plot(part["step"], part["fn"], color=colour, label=f"{told}, false negatives")
                    axes.plot(part["step"], part["fp"], color=colour, linestyle=":", label=f"{told}, false positives")
                last = part["step"][-1]
                for step in range(part["stage"], last, part["stage"]):
                    axes.axvline(step, color=PALE, linewidth=0.8, zorder=0)
                axes.set_yscale("symlog", linthresh=LEAST, linscale=0.4)
                axes.set_yticks([0, 0.01, 0.1, 1, 10, 100], ["0", "0.01", "0.1", "1", "10", "100"])
                axes.set_ylim(-LEAST / 4, 100)
                axes.set_xlim(0, last)
                axes.minorticks_off()
                axes.set_title(f"{label[0]}D {label.partition(chr(47))[2]}", loc="left", fontsize=10, fontweight="bold")
                axes.set_xlabel("training steps")
                axes.spines[["top", "right"]].set_visible(False)
                axes.tick_params(labelsize=8)
            panels[0].set_ylabel("% of points")
            figure.legend(
                *panels[0].get_legend_handles_labels(), frameon=False, fontsize=8, loc="lower center", ncols=2
            )

        return page(fill)

    def facts(self, parts):
        told = [f"{name}: FP {part['fp'][-1]:.2f}, FN {part['fn'][-1]:.3f}" for name, part in parts.items()]
        return [f"At the last record, %: {'; '.join(told)}."]
