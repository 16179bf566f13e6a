"""``warp-bounding info``: what a bounder file holds, and what is proven of it."""

from rich.table import Table

from warp_bounding.cli.output import (
    NOT_CONSERVATIVE,
    BounderFile,
    Json,
    certificate_summary,
    console,
    print_json,
    quiet_warp,
)

__all__ = ["command"]


def command(file: BounderFile, json: Json = False) -> int:
    """Describe FILE: method, sizes, domain, certificate. Exit status 1 if it holds no proof."""
    from warp_bounding.bounders import load

    quiet_warp()
    bounder = load(file, device="cpu")
    certificate, info = bounder.certificate, bounder.info
    if json:
        fields = {
            k: info.get(k)
            for k in ("name", "indicator", "grid_shape", "margin", "resolution", "seed", "note", "library")
        }
        summary = certificate_summary(bounder, certificate) if certificate else None
        sizes = bounder.sizes if bounder.method != "voxels" else {}
        print_json(
            {
                "path": file,
                "method": bounder.method,
                "query": bounder.query_kind,
                "dimension": bounder.ndim,
                "space": bounder.domain.space,
                "length": bounder.domain.length,
                "conservative": bounder.conservative,
                "bytes": bounder.nbytes,
                "threshold": float(bounder.threshold),
                **sizes,
                **fields,
                "training": info.get("training"),
                "certificate": summary,
            }
        )
        return 0 if certificate and certificate.proven else 1
    table = Table(show_header=False, box=None, pad_edge=False)
    rows = {
        "method": f"{bounder.method}, {bounder.ndim}D {bounder.query_kind} queries, {bounder.nbytes:,} bytes",
        "shape": f"{info.get('name')}, cells {info.get('grid_shape')}, margin {info.get('margin')}",
        "note": info.get("note"),
        "space": bounder.domain.space if bounder.query_kind != "point" else "",
        "length": f"{bounder.domain.length:g} (object units)" if bounder.domain.length else "",
        "domain": f"{bounder.domain.lower.tolist()} to {bounder.domain.upper.tolist()} (object space)",
        "threshold": f"{float(bounder.threshold):.9g}",
        **{key: str(value) for key, value in bounder.sizes.items()},
    }
    if certificate:
        rows |= {
            "certificate": certificate.kind,
            "what is proven" if certificate.proven else "what is known": certificate.message,
            "over": f"every input within {max(certificate.delta):.2g} of a cell from an occupied cell, which covers the rounding of "
            "float64 queries, of the map and of transforms that the placement check lets through",
            "arithmetic": certificate.arithmetic,
            "not proven": "anything about the mesh beyond its cells' cover of it, and nothing about other shapes",
            "search": f"{certificate.boxes:,} boxes in {certificate.seconds:.2f} s",
        }
        if not certificate.proven:
            rows |= {
                "over": "",
                "not proven": "that no query is missed; a rate holds for queries of the stated distribution",
                "search": f"{certificate.samples:,} fresh positives in {certificate.seconds:.2f} s",
            }
    else:
        rows["certificate"] = "none" if bounder.conservative else NOT_CONSERVATIVE
    for key, value in rows.items():
        if value:
            table.add_row(key, value)
    console(False).print(table)
    return 0 if certificate and certificate.proven else 1
