"""The gallery: every demo by its picture, and every notebook by a picture, its title and its first sentence.

Nothing is executed. The picture is the largest of the notebook's own outputs, made small; a notebook without one has a
card without a picture.
"""

import base64
import io
import json
import re
from pathlib import Path

from PIL import Image

__all__ = ["card", "gallery", "picture", "summary"]

LONGEST = 150  # characters of a summary of several sentences
WIDTH = 640  # pixels of a thumbnail, twice of what it is shown at
DEMOS = {  # pictures of docs: title, command, and what is seen
    "rain.png": ("Rain", "particles", "100,000 drops on a bunny that turns, twists and swells."),
    "cloth.png": ("Cloth", "cloth", "Newton's cloth on two meshes."),
    "path.png": ("Paths", "path", "Roadmaps in two maps."),
    "arm.png": ("Arms", "arm", "Plans of arms with three and four joints."),
    "panda.png": ("Seven joints", "arm", "A Panda's plan, every motion proven, and another around a post."),
    "ur5.png": ("A UR5", "arm", "A robot plans among furniture, by two proven networks."),
    "shadows.png": ("Shadows", "shadows", "Shadow rays of a bunny and a chair."),
    "pile.png": ("Pile", "pile", "Two hundred bunnies and rings in a box."),
}
HEAD = """# Gallery

## Demos

@demos@

## Notebooks

A course: each is shown with the outputs that it had when it was run last, from top to bottom.
To run them yourself: `pip install '.[notebooks]'`, and open the folder `notebooks` in Jupyter.

"""


def picture(notebook: dict) -> Image.Image | None:
    """The picture with the most pixels among a notebook's outputs; the first of several."""
    outputs = [output for cell in notebook["cells"] for output in cell.get("outputs", ())]
    found = [output["data"]["image/png"] for output in outputs if "image/png" in output.get("data", {})]
    images = [Image.open(io.BytesIO(base64.b64decode("".join(content)))) for content in found]
    return max(images, key=lambda image: image.width * image.height, default=None)


def summary(notebook: dict) -> tuple[str, str]:
    """A notebook's title, and the first sentences below it.

    Raises:
        ValueError: If it does not begin with a title.
    """
    first = "".join(notebook["cells"][0]["source"])
    found = re.match(r"# (.+)\n+((?:.+\n?)+)", first)
    if notebook["cells"][0]["cell_type"] != "markdown" or found is None:
        raise ValueError(f"expected a notebook that begins with a title and a paragraph, got {first[:60]!r}")
    first, *others = re.split(r"(?<=[.?!]) (?=[*A-Z`])", " ".join(found[2].split()))
    text = first
    for sentence in others:
        if len(text) + len(sentence) > LONGEST:
            break
        text += f" {sentence}"
    return found[1].strip(), text


def card(path: Path, folder: Path) -> str:
    """A notebook's card in MyST; its thumbnail is written beside the notebook.

    Args:
        path: The notebook.
        folder: The sources of the site, in which it lies.
    """
    notebook = json.loads(path.read_text(encoding="utf-8"))
    title, text = summary(notebook)
    lines = [
        f":::{{grid-item-card}} {title}",
        f":link: {path.relative_to(folder).with_suffix('').as_posix()}",
        ":link-type: doc",
    ]
    image = picture(notebook)
    if image is not None:
        small = path.with_suffix(".png")
        image = image.convert("RGB")
        image.thumbnail((WIDTH, WIDTH))
        image.save(small, optimize=True)
        lines += [f":img-top: {small.relative_to(folder).as_posix()}", f":img-alt: A picture from the notebook {title}"]
    return "\n".join([*lines, "", text, ":::"])


def demo_cards(folder: Path) -> list[str]:
    """Cards of the demos in MyST; writes their thumbnails into the pictures' folder."""
    cards = []
    for name, (title, command, text) in DEMOS.items():
        image, small = Image.open(folder / name).convert("RGB"), folder / f"small-{name}"
        image.thumbnail((WIDTH, WIDTH))
        image.save(small, optimize=True)
        lines = [f":::{{grid-item-card}} {title}", ":link: simulations", ":link-type: doc", f":img-top: {small.name}"]
        lines += [f":img-alt: {title}: {text}", "", f"{text} `python -m sims {command}`", ":::"]
        cards.append("\n".join(lines))
    return cards


def gallery(notebooks: list[Path], folder: Path) -> None:
    """Write the page ``gallery.md`` and the thumbnails.

    Args:
        notebooks: In the order in which they are shown.
        folder: The sources of the site.
    """
    names = [path.relative_to(folder).with_suffix("").as_posix() for path in notebooks]
    head = HEAD.replace("@demos@", "\n\n".join(["::::{grid} 1 2 2 3\n:gutter: 3", *demo_cards(folder), "::::"]))
    cards = "\n\n".join(card(path, folder) for path in notebooks)
    tree = "\n".join(["```{toctree}", ":hidden:", "", *names, "```"])
    (folder / "gallery.md").write_text(
        f"{head}::::{{grid}} 1 2 2 3\n:gutter: 3\n\n{cards}\n\n::::\n\n{tree}\n", encoding="utf-8"
    )
