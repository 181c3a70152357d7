"""Read and write the model of `rhizotwin biomass fit` as a JSON file, and tabulate its predictions."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from rhizotwin.experiment.biomass import Model, Relation, applicable_relations
from rhizotwin.experiment.measured import Measured
from rhizotwin.scenes import atomic, solution, subject
from rhizotwin.scenes.assessment import Assessment
from rhizotwin.scenes.provenance import versions
from rhizotwin.scenes.schema import Place, from_plain, to_plain
from rhizotwin.scenes.trait_table import csv_text, format_exact
from rhizotwin.scenes.versioned_json import read_versioned_json

SCHEMA_VERSION = 1


@dataclass(frozen=True, kw_only=True)
class Predicted:
    """Predicted mass of a plant."""

    measured: Measured
    """Traits of the plant."""
    relation: Relation
    """Relation from which the mass is predicted."""
    grams: float
    """Predicted mass, g."""
    low_g: float
    """Lower end of the 90 % interval, g."""
    high_g: float
    """Upper end of the 90 % interval, g."""

    @property
    def assessment(self) -> Assessment:
        """Assessment of the trait from which the mass is predicted."""
        return self.measured.assessment(self.relation.trait)

    @property
    def beyond(self) -> bool:
        """Whether the trait lies outside the range of the plants used in the fit."""
        return not self.relation.least <= self.measured.traits[self.relation.trait] <= self.relation.most


@dataclass(frozen=True, kw_only=True)
class _Stored:
    """Contents of a model file."""

    schema_version: int
    """Version of the file format."""
    model: Model
    """Fitted model."""
    versions: dict[str, str]
    """Versions of the software that wrote the file."""


def save_model(model: Model, path: Path) -> None:
    """Write a model to a JSON file atomically."""
    atomic.write_json(path, to_plain(_Stored(schema_version=SCHEMA_VERSION, model=model, versions=versions(("numpy", "scipy")))))


def load_model(path: Path) -> Model:
    """Read a model from a JSON file.

    Raises
    ------
    UserError
        If the file is missing, damaged or of an unsupported version.
    """
    return from_plain(_Stored, read_versioned_json(path, SCHEMA_VERSION), Place(str(path))).model


def predict(model: Model, measured: Sequence[Measured]) -> list[Predicted]:
    """Predict the masses of all plants whose results contain the traits of the model."""
    found = []
    for one in measured:
        for relation in applicable_relations(model, one):
            grams, low, high = relation.predict(one.traits[relation.trait], one.log_sigma(relation.trait))
            found.append(Predicted(measured=one, relation=relation, grams=grams, low_g=low, high_g=high))
    return found


def to_csv(found: Sequence[Predicted]) -> str:
    """Return a CSV table with one row per predicted mass.

    It contains the plant, the mass with its 90 % interval, and the reliability.
    """
    dissolved = solution.headings([one.measured.ions for one in found])
    rows: list[list[str]] = [
        ["result", *subject.NAMES, *dissolved.values(), "mass", "mass (g)", "low (g)", "high (g)", "from", "verdict", "extrapolated"]
    ]
    for one in found:
        numbers = [format_exact(value) for value in (one.grams, one.low_g, one.high_g)]
        states = [one.assessment.verdict, "yes" if one.beyond else "no"]
        whose = subject.as_text(one.measured.subject).values()
        ions = [format_exact(one.measured.ions.get(ion)) for ion in dissolved]
        rows.append([one.measured.name, *whose, *ions, one.relation.kind, *numbers, one.relation.trait, *states])
    return csv_text(rows)
