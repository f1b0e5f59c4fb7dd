"""Recurrent cells of the closed list, with an agent's memory as one tensor.

n rows (or any leading axes), H numbers of memory in each.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

from xmarl_bench.policy.architecture import Memory

Cell = nn.GRUCell | nn.LSTMCell


def recurrent_cell(memory: Memory, widths: list[int]) -> Cell:
    """torch's cell for a record, with initial weights.

    widths: input widths of each layer and, last, of the decoder; the cell's width replaces one of them.
    """
    n_in, widths[memory.after] = widths[memory.after], memory.width
    return (nn.GRUCell if memory.cell == "gru" else nn.LSTMCell)(n_in, memory.width)


def remember(
    record: Memory | None, cell: Cell | None, place: int, x: Tensor, memory: Tensor
) -> tuple[Tensor, Tensor]:
    """(..., n_in), (..., H) -> (..., width) output of the cell, (..., H) next memory.

    Returns both unchanged if the cell is at another place, or if there is none. `memory` may lack leading
    axes of x. An LSTM's memory is its output, then its cell state.
    """
    if record is None or cell is None or record.after != place:
        return x, memory
    leading = x.shape[:-1]
    rows, before = x.flatten(0, -2), memory.expand(*leading, -1).flatten(0, -2)
    if isinstance(cell, nn.GRUCell):
        output: Tensor = cell(rows, before)
        after = output
    else:
        output, state = cell(rows, before.chunk(2, dim=-1))
        after = torch.cat([output, state], dim=-1)
    return output.view(*leading, -1), after.view(*leading, -1)
