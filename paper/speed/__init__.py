"""The paper's Table 2, its supplement's table of speeds and its early-out plot, reproduced: methods raced on every device."""
