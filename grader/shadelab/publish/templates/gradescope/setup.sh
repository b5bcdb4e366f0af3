#!/usr/bin/env bash
# Gradescope runs this once, as root and with a network, when it builds the image. Everything that grading needs is made here.
set -euo pipefail
source=$(dirname -- "$(readlink -f -- "${BASH_SOURCE[0]}")") # /autograder/source
home=/opt/shadelab

rm -rf "$home"
cp -R "$source/shadelab" "$home"
chmod +x "$home/shadelab"
cd "$home"
./shadelab reference __NAME__ # system packages, Python packages, the build, meshes, and what the solution computes

# The proof, before students meet it: on this image the solution has every point.
./shadelab grade solution/__NAME__ --out out/proof --fail-under 100

# Plugins and the proof's report are the solution in other forms. What is left of it is root's alone, the zip's content included.
rm -rf out .shadelab/plugins .shadelab/work
chmod -R go-rwx "$source" solution .shadelab/expected
[[ ! -d .shadelab/hidden ]] || chmod -R go-rwx .shadelab/hidden
