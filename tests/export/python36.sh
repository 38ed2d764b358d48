#!/usr/bin/env bash
# Makes a virtual environment as a Jetson with JetPack 4.6 has it: python36.sh PYTHON3.6 FOLDER
# With torch 1.10.2, numpy 1.19.5, and onnxruntime 1.10.0; half a minute and 1.7 GB.
set -euo pipefail
python=$1 folder=$2
"$python" -m venv "$folder.new"
"$folder.new/bin/pip" install --quiet --disable-pip-version-check pip==21.3.1
"$folder.new/bin/pip" install --quiet numpy==1.19.5 torch==1.10.2 onnxruntime==1.10.0
mv "$folder.new" "$folder"
