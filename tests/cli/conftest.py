"""What tests of the command line share."""

import numpy as np
import pytest
from bounding_shapes import shape


@pytest.fixture
def files(tmp_path):
    """A folder with a shape, its complement, and a shape of another dimension."""
    np.save(tmp_path / "c.npy", shape("c").occupancy)
    np.save(tmp_path / "other.npy", ~shape("c").occupancy)
    np.save(tmp_path / "blob.npy", shape("blob").occupancy)
    return tmp_path
