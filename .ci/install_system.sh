#!/bin/sh
# Installs the system libraries that open3d and a virtual environment need (Debian, Ubuntu).
# As root: installs what is missing. Otherwise: prints the exact command and stops.
set -eu
python=${1:-python3}
packages="libusb-1.0-0 libgl1 libegl1 libx11-6 libgomp1"

if command -v "$python" >/dev/null 2>&1; then
  "$python" -c 'import sys; sys.exit(sys.version_info < (3, 11))' || {
    echo "Python 3.11 or newer is needed; '$python' is $("$python" -V 2>&1). Use: make PYTHON=/path/to/python3.11" >&2
    exit 1
  }
  "$python" -c 'import ensurepip, venv' 2>/dev/null || packages="$packages python3-venv"
else
  packages="$packages python3 python3-venv"
fi

if ! command -v dpkg-query >/dev/null 2>&1; then
  echo "Not a Debian or Ubuntu system: make sure that these libraries are there: $packages" >&2
  exit 0
fi
missing=""
for package in $packages; do
  dpkg-query -W -f='${Status}' "$package" 2>/dev/null | grep -q "install ok installed" \
    || missing="$missing $package"
done
[ -z "$missing" ] && exit 0

if [ "$(id -u)" = 0 ]; then
  echo "Installing system libraries:$missing"
  apt-get update -qq
  DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends $missing
else
  echo "These system libraries are missing. Install them, then run the same command again:" >&2
  echo "  sudo apt-get update && sudo apt-get install -y$missing" >&2
  exit 1
fi
