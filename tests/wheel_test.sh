#!/usr/bin/env bash
# Builds the wheel, or takes WHEEL, and spends a user's first ten minutes with it: in a clean environment and outside
# of the repository, they list, score an explainer of their own and open the page. All extras can be installed.
set -euo pipefail
unset PYTHONPATH  # only what the wheel brings
repository=$(cd "$(dirname "$0")/.." && pwd)
python=${PYTHON:-python3}
[[ $python == */* ]] && python=$(cd "$(dirname "$python")" && pwd)/$(basename "$python")
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT

if [[ -n ${WHEEL:-} ]]; then
    mkdir "$folder/dist"
    cp "$WHEEL" "$folder/dist"
else
    "$python" -m build --wheel --outdir "$folder/dist" "$repository"
fi
"$python" -m venv "$folder/venv"
"$folder/venv/bin/python" -m pip install --quiet --no-compile --constraint "$repository/constraints.txt" "$folder"/dist/*.whl

mkdir "$folder/elsewhere"
cd "$folder/elsewhere"
"$folder/venv/bin/python" - <<'PYTHON'
from importlib.metadata import distribution
from importlib.util import find_spec
from pathlib import Path

import xmarl_baselines, xmarl_bench, xmarl_envs

for package in (xmarl_envs, xmarl_bench, xmarl_baselines):
    assert "site-packages" in str(package.__file__), package.__file__
    assert Path(package.__file__).with_name("py.typed").exists(), f"{package.__name__} has no py.typed"
for name in ("envs", "baselines", "tests", "docs", "leaderboard"):
    assert find_spec(name) is None, f"the wheel brings a top-level module {name}"
top = {path.parts[0] for path in distribution("xmarl-bench").files or [] if path.parts[0] != ".."}
assert top == {"xmarl_bench", "xmarl_envs", "xmarl_baselines", next(t for t in top if t.endswith(".dist-info"))}, top
files = {str(path) for path in distribution("xmarl-bench").files or []}
for needed in ("xmarl_bench/board/templates/base.html.jinja", "xmarl_bench/board/assets/board.css"):
    assert needed in files, f"the wheel lacks {needed}"
assert any(name.endswith("policy.safetensors") for name in files), "the wheel brings no policy"
PYTHON
bin=$folder/venv/bin
"$bin/xmarl-bench" list tasks
policy=$("$bin/xmarl-bench" list policies --json | "$bin/python" -c 'import json, sys; print(json.load(sys.stdin)[0]["name"])')
"$bin/xmarl-bench" list explainers
cat > own.py <<'PYTHON'
import torch


def closest(policy, observations, generator):
    """(S, N, D) -> (S, N, N): the nearer the sender, the more its message matters."""
    position = observations[..., :2]
    return torch.exp(-torch.cdist(position, position))
PYTHON
"$bin/xmarl-bench" score --policy "$policy" --explainer attention --explainer own.py:closest --episodes 1 --timesteps 5 --out scores
test -s scores/leaderboard.json
"$bin/xmarl-bench" board serve scores --port 0 > address &
server=$!
trap 'kill "$server" 2>/dev/null || true; rm -rf "$folder"' EXIT
for _ in $(seq 600); do [[ -s address ]] && break; sleep 0.1; done
"$bin/python" - <<'PYTHON'
from pathlib import Path
from urllib.request import urlopen

address = Path("address").read_text().split()[0]
assert b"closest" in urlopen(address.replace("index.html", "leaderboard.json"), timeout=10).read()
assert b"<title>" in urlopen(address, timeout=10).read()
PYTHON
kill "$server"
"$bin/xmarl-bench" new explainer my-explainer  # tests/bench/plugins/test_installed_plugins.py installs and scores one
test -s my-explainer/pyproject.toml
extras=$("$bin/python" -c 'from importlib.metadata import metadata; print(*metadata("xmarl-bench").get_all("Provides-Extra"))')
wheel=$(echo "$folder"/dist/*.whl)
# `make venv` installs what all extras but docs bring; on a release (EACH_EXTRA) all, together and one by one.
for extra in docs ${EACH_EXTRA:+"${extras// /,}" $extras}; do
    "$bin/python" -m pip install --quiet --dry-run --constraint "$repository/constraints.txt" "$wheel[$extra]"
    echo "wheel-test: $extra can be installed"
done
echo "wheel-test: $(basename "$folder"/dist/*.whl) imports and scores outside of the repository"
