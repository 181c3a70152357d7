"""Bodies of the requests to the console's API."""

from pydantic import BaseModel, ConfigDict, Field

from rhizotwin.arguments import SubjectOptions


class Body(BaseModel):
    """A request's body; unknown keys are rejected."""

    model_config = ConfigDict(extra="forbid")


class TakeControl(Body):
    """A client takes control of the rig."""

    name: str = Field(max_length=200, description="Name shown to other clients")


class Command(Body):
    """A command of `rhizotwin rig jog`."""

    line: str = Field(max_length=200, description="Command, for example: table +9")


class Switch(Body):
    """Something is switched on or off."""

    on: bool


class Answer(Body):
    """Answer to a question to the person at the rig."""

    text: str = Field(max_length=1000)


class Finish(Body):
    """An interrupted scan is finished."""

    reconstruct: bool = Field(default=True, description="Reconstruct the finished scan")
    table_angle_deg: float | None = Field(
        default=None, ge=-360.0, le=360.0, description="Present angle of the table (deg), where the markers cannot be read"
    )


class StartScan(Finish):
    """A new scan."""

    name: str = Field(default="", max_length=100, description="Name of the scan; empty: plant and date")
    plant: str = Field(default="", max_length=200, description="Name of the plant, the same on every day")
    species: str = Field(default="", max_length=200)
    treatment: str = Field(default="", max_length=200, description="Treatment, for example: low N")
    day: float | None = Field(default=None, ge=0.0, le=36500.0, description="Days since sowing")
    date: str = Field(default="", max_length=10, description="Date of the scan, for example 2022-10-06")
    replicate: int | None = Field(default=None, ge=0, le=1000000)
    notes: str = Field(default="", max_length=1000)
    paused: bool = Field(default=False, description="Wait before the first picture")

    def subject(self) -> SubjectOptions:
        """Return the plant; empty texts leave the scene's."""
        texts = {name: getattr(self, name) or None for name in ("plant", "species", "treatment", "date", "notes")}
        return SubjectOptions(**texts, day=self.day, replicate=self.replicate)


class QueueScan(Body):
    """A scan is added to the queue."""

    scan: str = Field(max_length=100, description="Name of the scan")
