"""Packages that are large, or need one that is."""

from __future__ import annotations

# Distributions that a light installation leaves out, and their modules.
LARGE = {
    "axe-playwright-python": ("axe_playwright_python",),
    "benchmarl": ("benchmarl",),
    "captum": ("captum",),
    "graph-explain": ("graph_explain",),
    "lightshap": ("lightshap",),
    "playwright": ("playwright",),
    "ray": ("ray",),
    "shap": ("shap",),
    "stable-baselines3": ("stable_baselines3",),
    "tensorboard": ("tensorboard",),
    "torch": ("torch",),
    "torch-geometric": ("torch_geometric",),
    "torchrl": ("torchrl", "tensordict"),
    "vmas": ("vmas",),
}
