from keycld.data.clips import AbstractSampler as AbstractSampler
from keycld.data.clips import Clip as Clip
from keycld.data.clips import RandomFrames as RandomFrames
from keycld.data.clips import Resident as Resident
from keycld.data.clips import StartAndLater as StartAndLater
from keycld.data.clips import WholeTrajectories as WholeTrajectories
from keycld.data.clips import Windows as Windows
