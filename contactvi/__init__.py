"""contactvi: accurate rigid contact for URDF and MJCF models with variational integrators.

    import contactvi as cvi

    scene = cvi.load_scene("models/allegro_ball.toml")
    traj = cvi.simulate(scene)
    traj.save("run.npz")
    cvi.view(traj)

Every public name is loaded on first use, so that `import contactvi` stays quick and needs neither meshcat nor
matplotlib.
"""

from typing import Any

import lazy_loader

# The names stand in __init__.pyi, which type checkers and editors read too.
_load, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)


def __getattr__(name: str) -> Any:
    if name not in __all__:
        from contactvi.keywords import no_attribute

        raise AttributeError(no_attribute("contactvi", name, __all__))
    import numpy  # noqa: F401  (before coal, whose module crashes where Ctrl-C stops the import of NumPy it makes itself)

    return _load(name)
