"""The deliberate start of jobs that had to wait for a cause: what would move first, and the word for it.

A cause that goes away never starts motion (ISO 14118, 6.2; ISO 12100, 6.2.11.4): a job that had to wait for a permit,
an e-stop, a fault, a reference, a motor or a controller, and the jobs behind it, are ready to begin once the cause is
gone, and begin only by a word for the first motion that was shown.
"""

import hashlib
import json
from typing import Literal

from pydantic import Field

from orchestrator.model.base import Model
from orchestrator.model.jobs.service import JobReferences
from orchestrator.model.messages import Reply, Request

RESTART = "restart"
"""What holds a job that had to wait for a cause, until its start is asked for."""
READY = "ready to begin"
"""The state of such a job once the cause is gone, in words."""


class FirstMotion(Model):
    """What a job does first. text: its first step that moves something, in words; without one, that it moves nothing.
    cause: what the job had to wait for; empty: only for the start of the queue."""

    job_id: str
    name: str
    text: str
    axes: list[str] = Field(default=[])
    cause: str = ""


class StartPreview(Reply):
    """The jobs that would begin now, each with its first motion, and those that a cause still keeps from it.

    shown: stands for these motions in the word for them, which counts for nothing else. state: beside those of a
    report, for what waits for a job.
    """

    state: Literal["ready-to-begin"] = "ready-to-begin"

    motions: list[FirstMotion] = Field(default=[])
    lasting: list[FirstMotion] = Field(default=[], description="Jobs whose cause lasts; `cause` says which.")
    shown: str = ""

    @classmethod
    def of(cls, motions: list[FirstMotion], lasting: list[FirstMotion]) -> "StartPreview":
        """A preview with the digest of its motions."""
        plain = json.dumps([[motion.job_id, motion.text, motion.axes] for motion in motions])
        return cls(motions=motions, lasting=lasting, shown=hashlib.sha256(plain.encode()).hexdigest()[:16])


class PreviewStart(JobReferences):
    """What would move first if these jobs were released; without any, if the queue was started."""


class StartQueue(Request):
    """Start the queue, and give the word for the motions that were shown. shown: of the preview; empty: only the queue
    is started."""

    shown: str = Field(default="", max_length=64)


class ReleaseJobs(JobReferences):
    """Release held jobs. shown: of the preview of these jobs, if one of them had to wait for a cause."""

    shown: str = Field(default="", max_length=64)
