from .model.version import __version__ as __version__
from .synthesis.problem import Zonotope as Zonotope
from contextlib import suppress as suppress
