"""Request bodies of the console's REST API."""

from pydantic import BaseModel, ConfigDict, Field

from rhizotwin.steps.arguments import SubjectOptions


class Body(BaseModel):
    """Base class of request bodies, which rejects unknown keys."""

    model_config = ConfigDict(extra="forbid")


class TakeControl(Body):
    """Request to take control of the rig."""

    name: str = Field(max_length=200, description="Name of the client, shown to other clients")


class Command(Body):
    """Command of `rhizotwin rig jog` to execute."""

    line: str = Field(max_length=200, description="Command, such as: table +9")


class Switch(Body):
    """Request to switch a function on or off."""

    on: bool


class Answer(Body):
    """Answer to the question that the person at the rig is asked."""

    question: int = Field(description="Number of the question, which the state contains as question_number")
    text: str = Field(max_length=1000)


class Finish(Body):
    """Options for finishing an interrupted scan."""

    reconstruct: bool = Field(default=True, description="Add the finished scan to the queue of reconstructions")
    table_angle_deg: float | None = Field(
        default=None, ge=-360.0, le=360.0, description="Initial angle of the turntable, deg; required only if the markers cannot be read"
    )


class StartScan(Finish):
    """Options for starting a new scan."""

    name: str = Field(default="", max_length=100, description="Name of the scan; if empty, plant and date")
    plant: str = Field(default="", max_length=200, description="Name of the plant; use the same name for all scans of a plant")
    species: str = Field(default="", max_length=200)
    treatment: str = Field(default="", max_length=200, description="Treatment of the plant, such as: low N")
    day: float | None = Field(default=None, ge=0.0, le=36500.0, description="Age of the plant, in days since sowing")
    date: str = Field(default="", max_length=10, description="Date of the scan, such as 2022-10-06")
    replicate: int | None = Field(default=None, ge=0, le=1000000)
    notes: str = Field(default="", max_length=1000)
    paused: bool = Field(default=False, description="Pause the scan before the first picture")

    def subject(self) -> SubjectOptions:
        """Return the options that describe the plant. Empty strings leave the values in the scene unchanged."""
        texts = {name: getattr(self, name) or None for name in ("plant", "species", "treatment", "date", "notes")}
        return SubjectOptions(**texts, day=self.day, replicate=self.replicate)


class QueueScan(Body):
    """Scan to be added to the queue of reconstructions."""

    scan: str = Field(max_length=100, description="Name of the scan")
