"""The paper's volumes around the numbers of regions: plain NumPy, without kernels, proofs or files."""
