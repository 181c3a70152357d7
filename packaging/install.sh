#!/bin/sh
# Install rhizotwin into /opt/rhizotwin on a bare Debian or Ubuntu, as root: what the container images and a trial in a chroot do.
# usage: install.sh LOCK WHEEL [MORE ARGUMENTS OF PIP]
set -eu
lock=$1
wheel=$2
shift 2
if ! python3 -c 'import ensurepip, venv' 2>/dev/null; then
    apt-get -q update
    DEBIAN_FRONTEND=noninteractive apt-get -q -y --no-install-recommends install python3 python3-venv ca-certificates
    rm -rf /var/lib/apt/lists/*
fi
python3 -m venv /opt/rhizotwin
pip="/opt/rhizotwin/bin/python -m pip --disable-pip-version-check --no-cache-dir --quiet"
# Every library is pinned with its hash, LLVM among them.
$pip install --only-binary :all: --require-hashes "$@" -r "$lock"
$pip install --no-deps --no-index "$wheel"
# The wheel of LLVM makes its links when Python starts first, which must be able to write here.
/opt/rhizotwin/bin/python -c 'import glob; assert glob.glob("/opt/rhizotwin/lib/libLLVM.so*"), "LLVM has no links"'
ln -sf /opt/rhizotwin/bin/rhizotwin /usr/local/bin/rhizotwin
rhizotwin --version
