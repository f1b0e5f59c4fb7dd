"""States, attention and oracle tables of policies as files, to develop explainers without a simulation."""

from xmarl_bench.dataset.card import Card
from xmarl_bench.dataset.file import read_dataset, write_dataset, written
from xmarl_bench.dataset.tables import Dataset, dataset_name, planted_dataset, played_dataset

__all__ = [
    "Card", "Dataset", "dataset_name", "planted_dataset", "played_dataset", "read_dataset", "write_dataset",
    "written",
]  # fmt: skip
