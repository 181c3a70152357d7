"""Python client of the console's REST API, which needs only the standard library."""

from __future__ import annotations

import http.client
import json
import secrets
import time
from typing import Any
from urllib.error import HTTPError, URLError
from urllib.parse import parse_qs, quote, urlsplit
from urllib.request import ProxyHandler, Request, build_opener

from rhizotwin.scenes.errors import UserError

TIMEOUT_S = 120.0
"""Timeout of a request, s. The slowest request is the alignment of the arm."""
WAIT_S = 20.0
"""Maximum time, in seconds, for which a single request waits for a change of the state. The request is then
repeated."""


class Console:
    """Connection to a running console.

    Parameters
    ----------
    address : str
        Address printed by `rhizotwin console`; the token in the address is not needed if ``password`` is given.
    password : str
        Password of the console.

    Raises
    ------
    UserError
        If the address is not an HTTP address.

    Examples
    --------
    >>> console = Console(address)  # doctest: +SKIP
    >>> console.take_control("night robot")  # doctest: +SKIP
    >>> name = console.start_scan(plant="P7", day=12)  # doctest: +SKIP
    >>> console.wait_for_scan()  # doctest: +SKIP
    """

    def __init__(self, address: str, *, password: str = "") -> None:
        parts = urlsplit(address)
        if parts.scheme not in ("http", "https") or not parts.netloc:
            raise UserError(f"{address!r} is not the address of a console; use the address that 'rhizotwin console' prints")
        self._base = f"{parts.scheme}://{parts.netloc}"
        self._secret = password or parse_qs(parts.query).get("token", [""])[0]
        self._client = secrets.token_hex(16)
        self._opener = build_opener(ProxyHandler({}))  # no proxy, because a console is in the same network

    def request(self, method: str, path: str, body: dict[str, Any] | None = None) -> Any:
        """Send a request to the REST API, and return its response.

        Parameters
        ----------
        method, path : str
            HTTP method and path from the OpenAPI schema (``/api/openapi.json``).
        body : dict or None
            Request body as JSON values.

        Returns
        -------
        object
            JSON values, or bytes for other content types.

        Raises
        ------
        UserError
            If the console rejects the request (with the reason) or cannot be reached.
        """
        data = None if method == "GET" else b"" if body is None else json.dumps(body).encode()
        bearer = f"Bearer {self._secret}".encode().decode("latin-1")  # UTF-8: http.client encodes headers as Latin-1
        headers = {"Authorization": bearer, "X-Rhizotwin-Client": self._client, "Content-Type": "application/json"}
        request = Request(f"{self._base}{path}", data=data, method=method, headers=headers)
        try:
            with self._opener.open(request, timeout=TIMEOUT_S) as answer:
                content = answer.read()
                is_json = answer.headers.get_content_type() == "application/json"
        except HTTPError as error:
            raise UserError(_reason(error)) from None
        except (URLError, OSError, http.client.HTTPException) as error:
            raise UserError(f"the console at {self._base} could not be reached ({error}); check that it is running") from error
        return json.loads(content) if is_json else content

    def state(self, *, after: int = 0, wait_s: float = 0.0) -> dict[str, Any]:
        """Return the state of the devices, the latest picture, the scan, the queue and the messages.

        Parameters
        ----------
        after : int
            Version of the known state; the console waits for a newer version.
        wait_s : float
            Maximum waiting time.
        """
        found: dict[str, Any] = self.request("GET", f"/api/state?after={after}&wait_s={wait_s:g}")
        return found

    def take_control(self, name: str) -> None:
        """Take control of the rig, even if another client has control. Other clients see ``name``."""
        self.request("POST", "/api/control", {"name": name})

    def release_control(self) -> None:
        """Release control of the rig."""
        self.request("DELETE", "/api/control")

    def check_devices(self) -> list[dict[str, str]]:
        """Check each device without moving the rig, and return the states of the devices."""
        found: list[dict[str, str]] = self.request("POST", "/api/devices/check")
        return found

    def release_devices(self) -> None:
        """Switch off the lights, park the arm, switch off its torque and close the devices."""
        self.request("POST", "/api/devices/release")

    def command(self, line: str) -> list[str]:
        """Execute a command of ``rhizotwin rig jog``, such as ``table +9``, and return its output lines."""
        found: list[str] = self.request("POST", "/api/command", {"line": line})
        return found

    def take_picture(self) -> str:
        """Take a picture, store it in the console's folder, and return its file name."""
        return str(self.request("POST", "/api/picture")["name"])

    def picture(self) -> bytes:
        """Return the latest picture as JPEG."""
        found: bytes = self.request("GET", "/api/picture.jpg")
        return found

    def start_scan(self, **options: Any) -> str:
        """Start a scan, and return its name.

        Parameters
        ----------
        **options : object
            Fields of ``StartScan`` in the OpenAPI schema, such as plant, treatment, day, name and reconstruct.
        """
        return str(self.request("POST", "/api/scans", options)["name"])

    def finish_scan(self, name: str, **options: Any) -> None:
        """Finish an interrupted scan. ``options`` are fields of ``Finish`` in the OpenAPI schema."""
        self.request("POST", f"/api/scans/{quote(name, safe='')}/finish", options)

    def pause_scan(self) -> None:
        """Pause the running scan before its next picture."""
        self.request("POST", "/api/scan/pause")

    def continue_scan(self) -> None:
        """Continue the paused scan."""
        self.request("POST", "/api/scan/continue")

    def stop_scan(self) -> None:
        """Stop the running scan safely. The pictures taken so far are kept."""
        self.request("POST", "/api/scan/stop")

    def answer(self, text: str, *, question: int) -> None:
        """Answer the question that the person at the rig is asked.

        Parameters
        ----------
        text : str
            Answer.
        question : int
            Number of the question. The state contains the question as ``question``, and its number as
            ``question_number``.

        Raises
        ------
        UserError
            If another question is pending, or none.
        """
        self.request("POST", "/api/answer", {"question": question, "text": text})

    def start_schedule(self) -> None:
        """Start the schedule, which performs each planned scan of the experiment at its time."""
        self.request("POST", "/api/schedule/start")

    def stop_schedule(self) -> None:
        """Stop the schedule after the current scan."""
        self.request("POST", "/api/schedule/stop")

    def reconstruct(self, scan: str) -> None:
        """Add a complete scan to the queue of reconstructions."""
        self.request("POST", "/api/queue", {"scan": scan})

    def cancel_reconstruction(self, scan: str) -> None:
        """Remove a scan from the queue, or stop its reconstruction."""
        self.request("DELETE", f"/api/queue/{quote(scan, safe='')}")

    def report(self, scan: str) -> bytes:
        """Return the HTML page with the report of a reconstruction."""
        found: bytes = self.request("GET", f"/results/{quote(scan, safe='')}/report.html")
        return found

    def wait_for_scan(self, *, timeout_s: float = float("inf")) -> dict[str, Any]:
        """Wait until the running scan has ended, and return its final state.

        Raises
        ------
        UserError
            If the scan is still running after ``timeout_s``, or was not completed.
        """
        state = self._wait(lambda state: state["activity"] == "", timeout_s, "the rig is still busy after the timeout")
        scan: dict[str, Any] | None = state["scan"]
        if scan is None:
            raise UserError("no scan was started; start a scan first")
        listed = {one["name"]: one for one in state["scans"]}
        if not listed.get(scan["name"], {}).get("complete"):
            errors = [message["text"] for message in state["messages"] if message["kind"] == "error"]
            raise UserError(errors[0] if errors else f"the scan {scan['name']} was stopped before it was complete")
        return scan

    def wait_for_reconstruction(self, scan: str, *, timeout_s: float = float("inf")) -> dict[str, Any]:
        """Wait until the reconstruction of a scan has ended, and return its result.

        Raises
        ------
        UserError
            If the reconstruction failed, or has not ended after ``timeout_s``.
        """

        def ended(state: dict[str, Any]) -> bool:
            return not any(job["scan"] == scan and job["state"] in ("waiting", "running") for job in state["queue"])

        state = self._wait(ended, timeout_s, f"the scan {scan} is still in the queue after the timeout")
        job = next((job for job in state["queue"] if job["scan"] == scan), None)
        if job is not None and job["state"] == "failed":
            raise UserError(f"the reconstruction of {scan} failed: {job['error']}")
        result: dict[str, Any] | None = next((one["result"] for one in state["scans"] if one["name"] == scan), None)
        if result is None:
            raise UserError(f"the scan {scan} has no result; add it to the queue of reconstructions first")
        return result

    def _wait(self, until: Any, timeout_s: float, late: str) -> dict[str, Any]:
        end_s = time.monotonic() + timeout_s
        state = self.state()
        while not until(state):
            left_s = end_s - time.monotonic()
            if left_s <= 0.0:
                raise UserError(late)
            state = self.state(after=state["version"], wait_s=min(WAIT_S, left_s))
        return state


def _reason(error: HTTPError) -> str:
    """Return the console's reason for rejecting a request."""
    text = error.read().decode("utf-8", "replace").strip()
    try:
        detail = json.loads(text)["detail"]
    except (ValueError, KeyError, TypeError):
        return text or f"the console rejected the request ({error.code} {error.reason})"
    return detail if isinstance(detail, str) else "; ".join(f"{one['loc'][-1]}: {one['msg']}" for one in detail)
