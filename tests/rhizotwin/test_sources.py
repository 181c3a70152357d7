"""Which modules an entry point imports."""

import pytest

from rhizotwin import sources

PICTURES = "rhizotwin.sim"


def test_a_closure_follows_every_kind_of_import(tmp_path):
    for name, text in {
        "sim/__init__.py": "",
        "sim/a.py": "import rhizotwin.sim.b\nfrom rhizotwin.sim import c\n\n\ndef late():\n    from .d import e\n",
        "sim/b.py": "import numpy\nfrom rhizotwin.scenes.f import g as h\n",
        "sim/c.py": "from rhizotwin.sim import a\n",
        "sim/d.py": "",
        "sim/left_out.py": "",
        "scenes/__init__.py": "",
        "scenes/f.py": "",
    }.items():
        (tmp_path / "rhizotwin" / name).parent.mkdir(exist_ok=True, parents=True)
        (tmp_path / "rhizotwin" / name).write_text(text)
    scenes = ["rhizotwin.scenes", "rhizotwin.scenes.f"]
    assert sources.closure([f"{PICTURES}.a"], root=tmp_path) == [*scenes, PICTURES, *(f"{PICTURES}.{name}" for name in "abcd")]
    without = sources.closure([f"{PICTURES}.a"], root=tmp_path, without=frozenset({f"{PICTURES}.b"}))
    assert without == [PICTURES, *(f"{PICTURES}.{name}" for name in "acd")]
    with pytest.raises(FileNotFoundError, match=r"sim\.z"):
        sources.closure([f"{PICTURES}.z"], root=tmp_path)
