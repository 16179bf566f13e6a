"""No file of the repository names a folder of the machine that it was made on."""

import subprocess
from pathlib import Path

import pytest
from named_folders import folders

ROOT = Path(__file__).parents[1]


def tracked() -> list[str]:
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, check=False)
    if listed.returncode != 0:
        pytest.skip("this is no checkout: there is no list of its files")
    return [name for name in listed.stdout.decode().split("\0") if name and (ROOT / name).is_file()]


def test_no_tracked_file_names_a_folder_of_a_machine():
    names = tracked()
    assert len(names) > 100
    found = {name: where for name in names if (where := folders(name, (ROOT / name).read_bytes()))}
    assert not found
