"""Which modules an entry point imports."""

import pytest

from rhizotwin import sources


def test_a_closure_follows_every_kind_of_import(tmp_path):
    for name, text in {
        "sim/__init__.py": "",
        "sim/a.py": "import sim.b\nfrom sim import c\n\n\ndef late():\n    from .d import e\n",
        "sim/b.py": "import numpy\nfrom scenes.f import g as h\n",
        "sim/c.py": "from sim import a\n",
        "sim/d.py": "",
        "sim/left_out.py": "",
        "scenes/__init__.py": "",
        "scenes/f.py": "",
    }.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text)
    everything = ["scenes", "scenes.f", "sim", "sim.a", "sim.b", "sim.c", "sim.d"]
    assert sources.closure(["sim.a"], root=tmp_path) == everything
    assert sources.closure(["sim.a"], root=tmp_path, without=frozenset({"sim.b"})) == ["sim", "sim.a", "sim.c", "sim.d"]
    with pytest.raises(FileNotFoundError, match=r"sim\.z"):
        sources.closure(["sim.z"], root=tmp_path)
