"""Recurrent cells of the closed list: what an agent remembers goes in and comes out as one tensor.

n rows (or any leading axes), H numbers to remember of each.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

from xmarl_bench.policy.architecture import Memory

Cell = nn.GRUCell | nn.LSTMCell


def recurrent_cell(memory: Memory, widths: list[int]) -> Cell:
    """torch's cell of a record, with its initial weights.

    widths: of what goes into each layer and, last, the decoder; the cell's own takes the place of one.
    """
    n_in, widths[memory.after] = widths[memory.after], memory.width
    return (nn.GRUCell if memory.cell == "gru" else nn.LSTMCell)(n_in, memory.width)


def remember(
    record: Memory | None, cell: Cell | None, place: int, x: Tensor, memory: Tensor
) -> tuple[Tensor, Tensor]:
    """(..., n_in), (..., H) -> (..., width) what the cell gives, (..., H) what is remembered next.

    Both stay what they are where the cell has another place, or there is none. `memory` may lack leading axes
    that x has. An LSTM's is its output, then its cell state.
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
