"""Speed against error of every forward model, beside what a user would use instead: ``vcavity bench``.

Each of ``diffusing``, ``mirrors``, ``interfaced`` and ``random_grooves`` runs by itself, too:
``python -m fitting.bench.mirrors``.
"""
