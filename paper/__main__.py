"""``python -m paper table1|speed|figures|proofs|recipes``, in a clone of the repository."""

from warp_bounding.cli import app_of, main


def _app():
    from paper import figures, proofs, recipes, speed, table1

    about = "The paper's tables and figures, computed and drawn: resumable at any moment."
    modules = (table1, recipes, speed, proofs, figures)
    return app_of("paper", about, {module.__name__.rpartition(".")[2]: module.command for module in modules})


def run(arguments: list[str] | None = None) -> None:
    """Run the command line and exit with its status."""
    main(arguments, "paper", _app)


if __name__ == "__main__":
    run()
