"""`rhizotwin console` as it is typed: mistakes, the password, and the end by Ctrl-C."""

import signal
import subprocess
import urllib.request
from pathlib import Path

import pytest

from rhizotwin.commands.console import PASSWORD_VARIABLE
from rhizotwin.console.client import Console
from tests.command import Command
from tests.rhizotwin.console.conftest import console_process


def test_mistakes(tmp_path: Path, command: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(PASSWORD_VARIABLE, raising=False)
    command.fails("console", named=["either --rig RIG and --output FOLDER, or --experiment FILE"])
    words = ("console", "--rig", "twin", "-o", tmp_path / "lab", "--fidelity", "sketch", "--no-browser")
    command.fails(*words, "--host", "0.0.0.0", named=["needs a password", PASSWORD_VARIABLE])
    monkeypatch.setenv(PASSWORD_VARIABLE, "short")
    command.fails(*words, "--host", "0.0.0.0", named=["at least 8 characters"])
    command.fails(*words, "--host", "localhost.invalid.", named=["needs a password"])
    assert not (tmp_path / "lab").exists()
    monkeypatch.setenv(PASSWORD_VARIABLE, "long enough")
    command.fails(*words, "--host", "192.0.2.1", named=["cannot use the address 192.0.2.1"])


def test_ctrl_c_leaves_the_rig_safe(tmp_path: Path, scene_file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(PASSWORD_VARIABLE, "long enough")
    words = ("--rig", "twin", "--scene", scene_file, "-o", tmp_path / "lab", "--fidelity", "sketch", "--host", "0.0.0.0")
    with console_process(*words, port=8795, stderr=subprocess.STDOUT) as (process, printed):
        text, address = "\n".join(printed), printed[-1]
        assert "with the password" in text
        assert "not encrypted" in text
        assert "long enough" not in text
        console = Console(address.partition("?")[0], password="long enough")
        console.take_control("Anna")
        console.command("lights 1 1")
        assert console.start_scan(plant="P7", paused=True).startswith("P7-")
        process.send_signal(signal.SIGINT)
        said, _ = process.communicate(timeout=120)
    assert process.returncode == 130
    assert "the queue are kept; run the same command again to continue" in said
    with pytest.raises(OSError, match="refused"):
        urllib.request.urlopen(address, timeout=5)
