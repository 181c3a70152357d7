"""`rhizotwin console` as it is typed: mistakes, the password, and the end by Ctrl-C."""

import os
import signal
import subprocess
import sys
import urllib.request
from pathlib import Path

import pytest

from rhizotwin.commands.console import PASSWORD_VARIABLE
from rhizotwin.console.client import Console
from tests.command import Command

ROOT = Path(__file__).resolve().parents[3]


def test_mistakes(tmp_path: Path, command: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(PASSWORD_VARIABLE, raising=False)
    command.fails("console", named=["either --rig RIG and --output FOLDER, or --experiment FILE"])
    command.fails("console", "--rig", tmp_path / "rig.toml", "-o", tmp_path / "lab", named=["--scene is missing"])
    command.fails(
        "console", "--rig", "twin", "--experiment", tmp_path / "e.toml", named=["--rig and --output cannot be used with --experiment"]
    )
    words = ("console", "--rig", "twin", "-o", tmp_path / "lab", "--fidelity", "sketch", "--no-browser")
    command.fails(*words, "--host", "0.0.0.0", named=["needs a password", PASSWORD_VARIABLE])
    monkeypatch.setenv(PASSWORD_VARIABLE, "short")
    command.fails(*words, "--host", "0.0.0.0", named=["at least 8 characters"])
    command.fails(*words, "--host", "localhost.invalid.", named=["needs a password"])
    assert not (tmp_path / "lab").exists()
    monkeypatch.setenv(PASSWORD_VARIABLE, "long enough")
    command.fails(*words, "--host", "192.0.2.1", named=["cannot use the address 192.0.2.1"])


def test_ctrl_c_leaves_the_rig_safe(tmp_path: Path, scene_file: Path) -> None:
    words = ["console", "--rig", "twin", "--scene", str(scene_file), "-o", str(tmp_path / "lab"), "--fidelity", "sketch"]
    environment = {**os.environ, "PYTHONPATH": str(ROOT), PASSWORD_VARIABLE: "long enough"}
    process = subprocess.Popen(
        [sys.executable, "-m", "rhizotwin", *words, "--no-browser", "--port", "8795", "--host", "0.0.0.0"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=environment,
    )
    try:
        assert process.stdout is not None
        printed = [line for line, _ in zip(process.stdout, range(3), strict=False)]
        assert "with the password" in printed[0]
        assert "not encrypted" in printed[1]
        assert "long enough" not in "".join(printed)
        address = printed[2].strip()
        console = Console(address.partition("?")[0], password="long enough")
        console.take_control("Anna")
        console.command("lights 1 1")
        name = console.start_scan(plant="P7", paused=True)
        assert name.startswith("P7-")
        process.send_signal(signal.SIGINT)
        _, errors = process.communicate(timeout=120)
    finally:
        process.kill()
    assert process.returncode == 130
    assert "the queue are kept; run the same command again to continue" in errors
    with pytest.raises(OSError, match="refused"):
        urllib.request.urlopen(address, timeout=5)
