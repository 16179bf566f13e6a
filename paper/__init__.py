"""The paper's tables and figures, reproduced, and what a proof is worth: ``python -m paper``, resumable at any moment.

``table`` says what the tables are made of, ``data`` which objects there are, ``results`` reads and writes, ``cells``
fits. Each table and its page is a file of its name; ``figures`` and ``gallery`` are the figures, drawn with
``drawing``.
"""
