"""contactvi: accurate rigid contact for URDF and MJCF models with variational integrators.

    import contactvi as cvi

    scene = cvi.load_scene("models/allegro_ball.toml")
    traj = cvi.simulate(scene)
    traj.save("run.npz")
    cvi.view(traj)

Every public name is loaded on first use, so that `import contactvi` stays quick and needs neither meshcat nor
matplotlib.
"""

import lazy_loader
import numpy as _numpy  # noqa: F401  (before coal, which crashes where Ctrl-C stops its own import of NumPy)

# The names stand in __init__.pyi, which type checkers and editors read too.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
