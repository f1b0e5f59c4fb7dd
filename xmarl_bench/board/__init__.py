"""The leaderboard: derived from entries only, never edited.

`leaderboard.json`, `leaderboard.csv` and the page are functions of the entries (the page also of the existing
animations), so anyone can rebuild them byte for byte.
"""

from __future__ import annotations

from xmarl_bench.board.build import build_board, check_board
from xmarl_bench.board.columns import ORDER
from xmarl_bench.board.tables import board_of

__all__ = ["ORDER", "board_of", "build_board", "check_board"]
