"""Messages of the console: advice that a person at a browser can follow."""

import pytest

from rhizotwin.console.messages import Messages, for_console
from rhizotwin.scenes.formatting import DEBUG_VARIABLE, error_sentence
from tests.rhizotwin.console.conftest import Lab


def test_advice_for_the_command_line_is_replaced() -> None:
    text = for_console(error_sentence(ValueError("shapes differ")))
    assert text.endswith("(ValueError: shapes differ); the traceback is in the terminal in which 'rhizotwin console' runs")
    assert DEBUG_VARIABLE not in text
    messages = Messages(lambda: None)
    messages.error("the table slipped; then finish the scan with --resume")
    assert messages.plain()[0]["text"] == "the table slipped; then finish the scan, or start it again"


def test_the_traceback_of_an_unexpected_error_is_in_the_terminal(lab: Lab, caplog: pytest.LogCaptureFixture) -> None:
    def fail() -> None:
        raise ValueError("shapes differ")

    with pytest.raises(ValueError, match="shapes differ"):
        lab.console.rig.begin("a failing action", fail).result()
    assert "Traceback" in caplog.text
    assert "in fail" in caplog.text
    assert "rhizotwin console" in str(lab.console.messages.plain()[0]["text"])
