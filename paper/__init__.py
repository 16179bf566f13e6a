"""The paper's Table 1 and figures, reproduced, and what a proof is worth: resumable runs over objects, queries and methods, and what is written of them.

``columns`` says what the table is, ``run`` and ``proofs`` measure, ``folder`` keeps what is measured (``rows``), ``pages`` show it.
``figures`` are the figures, by the protocol and with the tools of ``drawing``.
Importing these imports neither torch nor matplotlib.
"""
