"""A library in which nothing takes time: fits and measurements that depend on their inputs only, counted in a log."""

import contextlib
import json
import signal
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np

from paper.columns import COLUMNS, VARIANTS
from paper.rows import Row
from warp_bounding.bounders import METHODS
from warp_bounding.bounders.bounder import taken
from warp_bounding.errors import BounderError, FileFormatError

RATES = {v.label: 40.0 - i for i, v in enumerate(VARIANTS)}
NO_SUCH = {("relu-field", "ray", 3), ("relu-field", "plane", 3), ("relu-field", "box", 3)}


def supports(method, query, ndim):
    """Everything but ReLU fields of six coordinates."""
    return (method, query, ndim) not in NO_SUCH


class Bounder(SimpleNamespace):
    """What the run needs of one; ``kind`` None: no certificate."""

    @property
    def certificate(self):
        """As a real one has it."""
        return SimpleNamespace(kind=self.kind, seconds=0.25) if self.kind else None


class Library:
    """The fakes.

    Attributes:
        log: File to which every fit and measurement adds a line.
        endless: Number of the fit that ends by a signal only; 0 for none.
        failing: Methods that fail.
        interrupted: Method whose fit is interrupted and returns early all the same, as the real one does.
        missing: Methods with false negatives.
    """

    def __init__(self, log: Path, endless=0, failing=(), interrupted=None, missing=()):
        self.log, self.endless, self.failing, self.interrupted = Path(log), endless, failing, interrupted
        self.missing, self.fits = missing, 0

    @property
    def calls(self) -> list[str]:
        """Lines of the log."""
        return self.log.read_text().splitlines() if self.log.exists() else []

    def _note(self, *words) -> None:
        with self.log.open("a") as file:
            file.write(" ".join(map(str, words)) + "\n")

    def fit(self, grid, *, query, method, seed, progress, space="geometric", leaves=None, last=None, **options):
        """See class."""
        known = taken((METHODS[name] for name in method.split("+")), query)
        expected = (
            {"hidden", "activation"} & set(known) | {"budget", "device"} | ({"length"} if query == "ray" else set())
        )
        assert set(options) == expected
        assert last is None or last.about["method"] == method.rpartition("+")[2] != method
        self._note("fit", grid.name, query, method, space, leaves)
        progress(0.5, 1.0, "half")
        if method in self.failing:
            if query == "ray":
                raise IndexError("out of bounds")
            raise BounderError(f"{method} cannot\nbe fitted")
        if method == self.interrupted:
            with contextlib.suppress(KeyboardInterrupt):
                signal.raise_signal(signal.SIGINT)
        self.fits += 1
        while self.fits == self.endless:
            time.sleep(1)
        kind = {"occupancy": None, "mlp": "statistical" if query == "ray" else "proven"}.get(method, "proven")
        info = {"indicator": grid.digest, "seed": seed, "training": {"seconds": 1.5}}
        about = {"method": method, "query": query, "space": space, "leaves": leaves}
        return Bounder(kind=kind, info=info, nbytes=100, about=about)

    def fit_parametric(self, grid, query, method, *, length, seed, seconds):
        """See class."""
        self._note("fit", grid.name, query, method, "parametric", None)
        about = {"method": method, "query": query, "space": "parametric", "leaves": None}
        return Bounder(kind=None, info={}, nbytes=100, about=about)

    def rates(self, volume, grid, samples, protocol, *, seed, progress, device):
        """See class."""
        return self.evaluate(volume, grid, samples, protocol, seed=seed, progress=progress)

    def evaluate(self, bounder, grid, samples, protocol, *, seed, progress):
        """See class."""
        about = bounder.about
        self._note("evaluate", grid.name, about["query"], about["method"], protocol)
        progress(samples, samples)
        variant = next(
            v
            for v in VARIANTS
            if (v.method, v.leaves) == (about["method"], about["leaves"])
            and (v.parametric == (about["space"] == "parametric") or not v.in_both_spaces)
        )
        rate = RATES[variant.label] + len(grid.name) + (5.0 if protocol == "sampled" else 0.0)
        fn = 7 if about["method"] in (*self.missing, "occupancy") else 0
        return SimpleNamespace(fp_rate=rate, fn=fn, positives=30.0)

    def save(self, bounder, path):
        """As JSON."""
        path.parent.mkdir(exist_ok=True)
        path.write_text(json.dumps(vars(bounder)))

    def load(self, path, device):
        """The same."""
        try:
            return Bounder(**json.loads(path.read_text()))
        except ValueError:
            raise FileFormatError(f"{path}: damaged") from None

    def load_shape(self, path):
        """A name, a dimension and a digest of the file."""
        ndim = int(path.parent.name[0])
        return SimpleNamespace(ndim=ndim, name=path.stem, digest=path.read_bytes().hex().ljust(64, "0"))

    def install(self, monkeypatch) -> None:
        """Put them in the library's place."""
        for place, fake in {
            "training.fit": self.fit,
            "evaluation.evaluate": self.evaluate,
            "bounders.save": self.save,
            "bounders.load": self.load,
            "bounders.supports": supports,
            "indicators.load_indicator": self.load_shape,
        }.items():
            monkeypatch.setattr(f"warp_bounding.{place}", fake)
        monkeypatch.setattr("paper.parametric.volumes.fit", self.fit_parametric)
        monkeypatch.setattr("paper.parametric.volumes.rates", self.rates)


def data_folder(path: Path) -> Path:
    """A folder in the authors' layout; the content means something to the fakes only."""
    for ndim, suffix, names in ((2, "png", "abc"), (3, "binvox", "ab"), (4, "npy", "a")):
        folder = path / f"{ndim}D"
        folder.mkdir(parents=True)
        for name in names:
            (folder / f"{name * 2}.{suffix}").write_text(f"{ndim}{name}")
    return path


def table_rows(rng: np.random.Generator, objects=3, protocols=("exact",)) -> list[Row]:
    """Rows of a whole table."""
    rows = []
    for column in COLUMNS:
        for variant in VARIANTS:
            space = variant.space_in(column)
            for number in range(objects if space else 0):
                for protocol in protocols:
                    rows.append(make_row(column, variant, f"shape{number}", space, protocol, rng.uniform(0, 90)))
    return rows


def make_row(column, variant, name="bunny", space="geometric", protocol="exact", fp_rate=12.5, **fields) -> Row:
    """A row that could have been measured with the default settings."""
    values = {
        "dimension": column.ndim,
        "object": name,
        "query": column.query,
        "method": variant.method,
        "space": space,
        "leaves": variant.leaves,
        "protocol": protocol,
        "fp_rate": fp_rate,
        "fn": 0,
        "positives": 30.0,
        "certificate": "proven" if variant.conservative else "",
        "fit_seconds": 1.0,
        "proof_seconds": 0.25,
        "nbytes": 2000,
        "hidden": "-".join(map(str, column.hidden)),
        "activation": "sin",
        "budget": 60.0,
        "samples": 1_000_000,
        "seed": 0,
        "length": 1.0,
        "device": "cpu",
        "threads": 2,
        "indicator": "0" * 16,
        "versions": "warp-bounding 0, Python 3",
    }
    return Row(**values | fields)
