#!/bin/sh
# Make a virtual environment with everything the project needs, as it is tested: launch/install.sh [folder]
# (What renders and trains alone goes into any environment of Python 3.11 to 3.13: pip install .)
# Needs no root. Names the line that installs a missing Python or system library.
set -eu
venv=${1:-.venv}
cd "$(dirname "$0")/.."

for candidate in "${PYTHON:-python3.11}" python3 python; do
    if "$candidate" -c 'import sys; sys.exit(sys.version_info[:2] != (3, 11))' 2>/dev/null; then
        python=$candidate
        break
    fi
done
if [ -z "${python:-}" ]; then
    echo "error: Python 3.11 is missing (requirements.lock is for it)." >&2
    echo "Install it: 'sudo apt-get install python3.11 python3.11-venv', 'brew install python@3.11' or 'pyenv install 3.11'," >&2
    echo "or name it: 'make PYTHON=/path/to/python3.11 …'." >&2
    exit 1
fi
if ! "$python" -c 'import venv, ensurepip' 2>/dev/null; then
    echo "error: Python's venv module is missing. Install it: sudo apt-get install python3.11-venv" >&2
    exit 1
fi

echo "Installing into $venv (about 8 GB with CUDA; two to three minutes on a fast line) …"
[ -x "$venv/bin/python" ] || "$python" -m venv "$venv"
"$venv/bin/python" -m pip install --quiet --disable-pip-version-check -c requirements.lock -e '.[all,slurm,dev]'

"$venv/bin/python" - <<'EOF'
import sys
from rfpp.errors import UserError
from rfpp.reference.cycles import require_blender

try:
    require_blender()
except UserError as error:
    sys.exit(f"error: {error}")
EOF

echo "Fetching the VGG16 weights of LPIPS …"
"$venv/bin/python" launch/weights.py || echo "Rendering does without them; training and evaluation need them." >&2

echo "Compiling the loops over rays …"
scratch=$(mktemp -d)
"$venv/bin/python" launch/render.py scene=data/scenes/cornell_box.json cameras=0 resolution=16 output="$scratch" >/dev/null
rm -r "$scratch"
