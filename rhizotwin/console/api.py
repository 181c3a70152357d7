"""REST API and web page of the console. The OpenAPI schema is available at ``/api/openapi.json``."""

from __future__ import annotations

import asyncio
import html
import time
from concurrent.futures import Future
from importlib.metadata import version
from importlib.resources import files
from typing import Annotated, Any
from urllib.parse import parse_qs, quote

from fastapi import FastAPI, Header, Query, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import FileResponse, HTMLResponse, JSONResponse, PlainTextResponse, RedirectResponse, Response, StreamingResponse

from rhizotwin.console import bodies as body
from rhizotwin.console.access import Access, cookie_of, login_headers
from rhizotwin.console.console import Console
from rhizotwin.console.downloads import zip_folder
from rhizotwin.console.messages import for_console
from rhizotwin.console.pictures import PICTURE_PX, jpeg
from rhizotwin.scenes import html_page
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.formatting import error_sentence, printable

LOOK_S = 0.05
"""Polling interval, in seconds, at which a waiting request checks whether the state has changed."""
LONGEST_WAIT_S = 30.0
"""Maximum time, in seconds, that a client may wait for a change of the state."""
REPORT_POLICY = (
    "sandbox allow-scripts allow-downloads; default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data: blob:"
)
"""Content security policy of reports. It forbids cookies and requests, because a report may contain untrusted
scripts."""
_PAGE = files("rhizotwin.console").joinpath("page")

Client = Annotated[str, Header(alias="X-Rhizotwin-Client", min_length=1, max_length=100, description="Random identifier of the client")]


def create_app(console: Console, access: Access) -> FastAPI:
    """Create the web application, which must be served behind `access.Guard`.

    Parameters
    ----------
    console : Console
        Console to control.
    access : Access
        Secrets for the login page.

    Returns
    -------
    FastAPI
        Web application.
    """
    app = FastAPI(
        title="rhizotwin console",
        version=version("rhizotwin"),
        summary="Control a root-imaging rig: devices, scans and reconstructions.",
        openapi_url="/api/openapi.json",
        docs_url=None,
        redoc_url=None,
    )

    @app.exception_handler(UserError)
    async def refused(request: Request, error: Exception) -> Response:
        text = for_console(str(error))
        if "text/html" in request.headers.get("accept", ""):  # a person who followed a link
            return PlainTextResponse(f"{text}\n", status_code=409)
        return JSONResponse({"detail": text}, status_code=409)

    @app.exception_handler(RequestValidationError)
    async def invalid(_: Request, error: RequestValidationError) -> JSONResponse:
        # without the values: NaN and unpaired surrogates cannot be sent back as JSON
        found = [{"loc": [*map(printable, map(str, one["loc"]))], "msg": printable(one["msg"])} for one in error.errors()]
        return JSONResponse({"detail": found}, status_code=422)

    _add_pages(app, access)
    _add_state(app, console)
    _add_files(app, console)
    _add_rig(app, console)
    _add_scans(app, console)
    _add_plans(app, console)
    return app


def _add_pages(app: FastAPI, access: Access) -> None:
    """Add the routes of the web page, its files and the login page."""

    @app.get("/", include_in_schema=False)
    def page(request: Request) -> HTMLResponse:
        secret = str(request.scope.get("state", {}).get("page_secret", ""))
        return HTMLResponse(_text("console.html").replace("PAGE_SECRET", html.escape(secret, quote=True)))

    @app.get("/console.css", include_in_schema=False)
    def style() -> Response:
        return Response(html_page.palette() + _text("console.css"), media_type="text/css")

    @app.get("/console.js", include_in_schema=False)
    def script() -> Response:
        return Response(_text("console.js"), media_type="text/javascript")

    @app.get("/hull.js", include_in_schema=False)
    def hull_script() -> Response:
        return Response(_text("hull.js"), media_type="text/javascript")

    @app.get("/login", include_in_schema=False)
    def login_page() -> HTMLResponse:
        return HTMLResponse(_text("login.html").replace("<!--error-->", ""))

    @app.post("/login", include_in_schema=False)
    async def login(request: Request) -> Response:
        given = parse_qs((await request.body()).decode("utf-8", "replace")).get("password", [""])[0]
        if not await access.allows(given):
            wrong = '<p class="wrong">The password is wrong.</p>'
            return HTMLResponse(_text("login.html").replace("<!--error-->", wrong), status_code=401)
        headers = login_headers(cookie_of(request.scope), access.new_session())
        return RedirectResponse(headers.pop("Location"), status_code=303, headers=headers)


def _add_state(app: FastAPI, console: Console) -> None:
    """Add the routes through which clients read the state and pictures."""

    @app.get("/api/state", tags=["state"], response_model=dict[str, Any])
    async def state(
        client: Client = "",
        after: Annotated[int, Query(description="Version of the state known to the client; wait for a newer version")] = 0,
        wait_s: Annotated[float, Query(ge=0.0, le=LONGEST_WAIT_S, description="Maximum waiting time, s")] = 0.0,
    ) -> JSONResponse:
        """Return the state of the devices, the latest picture, the scan, the queue and the messages."""
        end_s = time.monotonic() + wait_s
        while console.version == after and time.monotonic() < end_s:
            await asyncio.sleep(LOOK_S)
        return JSONResponse(await asyncio.to_thread(console.state, client, shared=wait_s > 0.0))

    @app.get("/api/picture.jpg", tags=["state"], response_class=Response, responses={200: {"content": {"image/jpeg": {}}}})
    def picture() -> Response:
        """Return the latest picture as JPEG, with the outlines of the detected markers."""
        shown = console.shown
        if shown is None:
            raise UserError("no picture has been taken yet; take a picture or start a scan first")
        return Response(shown.jpeg, media_type="image/jpeg")

    @app.get("/api/hull", tags=["state"], response_class=Response, responses={200: {"content": {"application/octet-stream": {}}}})
    def hull() -> Response:
        """Return the cells of the coarse hull of the roots as little-endian float32 values in mm.

        The first value is the edge length of a cell, and x, y and z of the centre of each cell follow.
        """
        cells_mm, edge_mm = console.hull()
        data = cells_mm.astype("<f4").tobytes()
        edge = cells_mm.dtype.type(edge_mm).astype("<f4").tobytes()
        return Response(edge + data, media_type="application/octet-stream")

    @app.get(
        "/api/scans/{name}/pictures/{number}.jpg", tags=["state"], response_class=Response, responses={200: {"content": {"image/jpeg": {}}}}
    )
    def scan_picture(
        name: str, number: int, width: Annotated[int, Query(ge=16, le=PICTURE_PX, description="Maximum width, px")] = PICTURE_PX
    ) -> Response:
        """Return a picture of a scan as JPEG. The first picture has the number 0."""
        data = jpeg(console.folders.picture(name, number), widest_px=width)
        return Response(data, media_type="image/jpeg")


def _add_files(app: FastAPI, console: Console) -> None:
    """Add the routes through which clients receive datasets, viewers and reports."""

    @app.get("/scans/{name}/dataset.zip", tags=["state"], response_class=StreamingResponse)
    def download(name: str) -> StreamingResponse:
        """Return the dataset of a scan as ZIP archive."""
        headers = {"Content-Disposition": f"attachment; filename*=UTF-8''{quote(name)}.zip"}
        return StreamingResponse(zip_folder(console.folders.scan(name)), media_type="application/zip", headers=headers)

    @app.get("/results/{name}/viewer", tags=["state"], status_code=303, response_class=RedirectResponse)
    def viewer(name: str, request: Request) -> RedirectResponse:
        """Start a viewer of a result, and redirect to its page, which has the next free port."""
        host, port = request.scope["server"]
        own_port, token = console.viewers.open(name, host=host, port=port + 1)
        address = request.url.replace(scheme="http", port=own_port, path="/", query=f"token={token}")
        return RedirectResponse(str(address), status_code=303)

    @app.get("/results/{name}/report.html", tags=["state"], response_class=FileResponse)
    def report(name: str) -> FileResponse:
        """Return the report of a reconstruction as an HTML page."""
        path = console.folders.report(name)
        return FileResponse(path, media_type="text/html", headers={"Content-Security-Policy": REPORT_POLICY})

    @app.get("/growth.html", tags=["state"], response_class=FileResponse)
    def growth() -> FileResponse:
        """Return the HTML page with the growth curves."""
        path = console.folders.growth()
        if path is None:
            raise UserError("the experiment has no growth curves yet; they appear when the first scans are reconstructed")
        return FileResponse(path, media_type="text/html", headers={"Content-Security-Policy": REPORT_POLICY})


def _add_rig(app: FastAPI, console: Console) -> None:
    """Add the routes that control the devices of the rig."""
    controls = console.controls

    @app.post("/api/control", tags=["control"])
    def take_control(request: body.TakeControl, client: Client) -> dict[str, object]:
        """Take control of the rig, even if another client has control."""
        controls.take(client, request.name)
        return controls.state(client)

    @app.delete("/api/control", tags=["control"])
    def release_control(client: Client) -> dict[str, object]:
        """Release control of the rig."""
        controls.release(client)
        return controls.state(client)

    @app.post("/api/devices/check", tags=["rig"])
    def check_devices(client: Client) -> list[dict[str, str]]:
        """Check each device without moving the rig, and return the states of the devices."""
        controls.require(client)
        _wait(console.by_hand.check_devices())
        return console.devices.plain()

    @app.post("/api/devices/release", tags=["rig"])
    def release_devices(client: Client) -> None:
        """Switch off the lights, park the arm, switch off its torque and close the devices."""
        controls.require(client)
        _wait(console.by_hand.let_go())

    @app.post("/api/command", tags=["rig"])
    def command(request: body.Command, client: Client) -> list[str]:
        """Execute a command of `rhizotwin rig jog`, and return its output lines."""
        controls.require(client)
        replies: list[str] = _wait(console.by_hand.command(request.line))
        return replies

    @app.post("/api/picture", tags=["rig"])
    def take_picture(client: Client) -> dict[str, str]:
        """Take a picture, write it to the folder `pictures`, and return its file name."""
        controls.require(client)
        return {"name": _wait(console.by_hand.take_picture())}

    @app.post("/api/live", tags=["rig"])
    def live(request: body.Switch, client: Client) -> None:
        """Switch the continuous display of pictures on or off."""
        controls.require(client)
        console.by_hand.set_live(on=request.on)


def _add_scans(app: FastAPI, console: Console) -> None:
    """Add the routes that start and control scans."""
    controls = console.controls

    @app.post("/api/scans", tags=["scans"], status_code=202)
    def start(request: body.StartScan, client: Client) -> dict[str, str]:
        """Start a scan, and return its name."""
        controls.require(client)
        more = request.model_dump(include={"name", "reconstruct", "paused", "table_angle_deg"})
        return {"name": console.start_scan(request.subject(), **more)}

    @app.post("/api/scans/{name}/finish", tags=["scans"], status_code=202)
    def finish(name: str, request: body.Finish, client: Client) -> None:
        """Finish an interrupted scan by taking the missing pictures."""
        controls.require(client)
        console.resume_scan(name, **request.model_dump())

    @app.post("/api/scan/pause", tags=["scans"])
    def pause(client: Client) -> None:
        """Pause the running scan before its next picture."""
        controls.require(client)
        console.running().live.pause(paused=True)

    @app.post("/api/scan/continue", tags=["scans"])
    def go_on(client: Client) -> None:
        """Continue the paused scan."""
        controls.require(client)
        console.running().live.pause(paused=False)

    @app.post("/api/scan/stop", tags=["scans"])
    def stop() -> None:
        """Stop the running scan safely: switch off the lights, park the arm and keep the pictures.

        Clients without control of the rig may also stop a scan.
        """
        console.running().live.stop()

    @app.post("/api/answer", tags=["rig"])
    def answer(request: body.Answer, client: Client) -> None:
        """Answer the question that the person at the rig is asked."""
        controls.require(client)
        console.questions.answer(request.text, number=request.question)


def _add_plans(app: FastAPI, console: Console) -> None:
    """Add the routes that control the schedule and the queue of reconstructions."""
    controls = console.controls

    @app.post("/api/schedule/start", tags=["schedule"], status_code=202)
    def start_schedule(client: Client) -> None:
        """Start the schedule, which performs each planned scan of the experiment at its time."""
        controls.require(client)
        console.start_schedule()

    @app.post("/api/schedule/stop", tags=["schedule"])
    def stop_schedule(client: Client) -> None:
        """Stop the schedule after the current scan."""
        controls.require(client)
        console.stop_schedule()

    @app.post("/api/queue", tags=["reconstructions"], status_code=202)
    def add(request: body.QueueScan, client: Client) -> None:
        """Add a complete scan to the queue of reconstructions."""
        controls.require(client)
        console.queue.add(request.scan)

    @app.delete("/api/queue/{scan}", tags=["reconstructions"])
    def remove(scan: str, client: Client) -> None:
        """Remove a scan from the queue, or stop its reconstruction."""
        controls.require(client)
        console.queue.remove(scan)


def _wait(future: Future[Any]) -> Any:
    """Wait until the rig's thread has completed an action, and return the result.

    Errors of other types are converted to `UserError`.
    """
    try:
        return future.result()
    except UserError:
        raise
    except Exception as error:
        raise UserError(error_sentence(error)) from error


def _text(name: str) -> str:
    return _PAGE.joinpath(name).read_text(encoding="utf-8")
