"""HTTP protocol between the camera server and its client.

    GET  /describe                                       -> JSON {program, protocol, camera}
    POST /prepare  JSON {session, settings}              -> JSON {camera}
    POST /capture  JSON {session, picture}               -> PNG, headers `SHA256`, `PICTURE`, `EXPOSURE_S`, `GAIN`
    any failure                                          -> JSON {error: one sentence}

The client chooses random identifiers of session and picture, so that a request can be repeated after its reply was
lost: a session is not prepared twice, and a picture is not taken twice. A session ends when the next session begins.
"""

import re

PROGRAM = "rhizotwin camera"
PROTOCOL = 2
DEFAULT_PORT = 8471
SHA256 = "Rhizotwin-Sha256"
PICTURE = "Rhizotwin-Picture"
EXPOSURE_S = "Rhizotwin-Exposure-S"
GAIN = "Rhizotwin-Gain"
NAME = re.compile(r"[0-9a-f]{32}")
"""Regular expression that the identifiers of sessions and pictures must match."""
