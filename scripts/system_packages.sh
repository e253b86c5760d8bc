#!/bin/sh
# System packages: what headless rendering needs, and with the argument `test` a browser for the report's tests.
# As root on Debian they are installed; otherwise one line says what is missing.
set -eu

wanted=""
for library in libEGL.so.1 libGL.so.1; do
    ldconfig -p 2>/dev/null | grep -q "$library" || wanted="libegl1 libgl1 libgl1-mesa-dri libegl-mesa0 libgles2"
done
python3 -c "import ensurepip" 2>/dev/null || wanted="$wanted python3-venv"
if [ "${1:-}" = test ] && ! command -v chromium >/dev/null && ! command -v google-chrome >/dev/null; then
    wanted="$wanted chromium"
fi
[ -z "$wanted" ] && exit 0

if [ "$(id -u)" -ne 0 ] || ! command -v apt-get >/dev/null; then
    echo "keycld: please install these system packages first: $wanted" >&2
    echo "        for example: sudo apt-get install $wanted" >&2
    exit 1
fi
export DEBIAN_FRONTEND=noninteractive
apt-get update -qq
# shellcheck disable=SC2086  # a list of packages
apt-get install -qq --yes --no-install-recommends $wanted >/dev/null
