#!/usr/bin/env bash
# Builds the wheel, or takes WHEEL, and tries it as a user would: a clean environment, outside of the repository.
set -euo pipefail
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
PYTHON
bin=$folder/venv/bin
"$bin/xmarl-bench" list tasks
policy=$("$bin/xmarl-bench" list policies --json | "$bin/python" -c 'import json, sys; print(json.load(sys.stdin)[0]["name"])')
"$bin/xmarl-bench" score --policy "$policy" --explainer attention --episodes 1 --timesteps 5 --out scores
test -s scores/leaderboard.json
"$bin/xmarl-bench" new explainer my-explainer
"$bin/python" -m pip install --quiet --no-deps ./my-explainer
"$bin/xmarl-bench" check explainer my-explainer
"$bin/xmarl-bench" score --policy "$policy" --explainer my-explainer --episodes 1 --timesteps 5 --out scores
echo "wheel-test: $(basename "$folder"/dist/*.whl) imports and scores outside of the repository"
