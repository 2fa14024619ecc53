"""Images of the arm, rendered by OpenGL without a display or drawn by matplotlib.

Backends are tried in the order EGL, OSMesa, matplotlib (macOS: CGL, matplotlib; Windows: GLFW,
matplotlib). The environment variable MUJOCO_GL selects one; "disable" means matplotlib. A driver
can crash the process, and a process can use only one backend, so each is tried once in a separate
process.

A thread may render what another one has opened. GLFW has windows, which it makes and destroys one
at a time, and outside Linux on the main thread alone.
"""

import contextlib
import functools
import importlib
import os
import platform
import subprocess
import sys
import threading
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cotlearn.robots.arm.kinematics import skeleton
from cotlearn.robots.arm.model import mujoco
from cotlearn.robots.task import Array

BACKENDS = {"Linux": ("egl", "osmesa"), "Darwin": ("cgl",), "Windows": ("glfw",)}
DRAWN = "matplotlib"
_TRIAL = "import mujoco as m; m.Renderer(m.MjModel.from_xml_string('<mujoco/>'))"
_SECONDS = 60  #: time limit of a trial
_WINDOWS = threading.RLock()  #: held while a window is made or destroyed
_kept: list[Any] = []  #: windows that were closed off the main thread, to be destroyed on it


def backend() -> str:
    """The backend of this machine: "egl", "osmesa", "cgl", "glfw" or "matplotlib"."""
    wanted = os.environ.get("MUJOCO_GL", "").strip().lower()
    if wanted in ("disable", "disabled", "off", "false", "0"):
        return DRAWN
    usual = BACKENDS.get(platform.system(), ())
    choice = (wanted,) if wanted in ("egl", "osmesa", "glfw", "cgl") else usual
    return next((name for name in choice if _works(name)), DRAWN)


@functools.cache
def _works(name: str) -> bool:
    environment = {key: value for key, value in os.environ.items() if key != "PYOPENGL_PLATFORM"}
    environment["MUJOCO_GL"] = name
    trial = [sys.executable, "-c", _TRIAL]
    try:
        subprocess.run(trial, env=environment, capture_output=True, timeout=_SECONDS, check=True)
    except (OSError, subprocess.SubprocessError):
        return False
    return True


class Painter:
    """Renders images of the arm with `backend`; the attribute `how` names the one in use.

    Args:
        model: an `MjModel` of the arm; a rendered model may differ from it only in its pillars.
        size: width and height of the images in pixels.
        camera: a camera of the model: "front" or "above".

    Raises:
        RuntimeError: GLFW is used on a thread that cannot open a window.
    """

    def __init__(self, model: Any, size: tuple[int, int], camera: str) -> None:
        self.how = backend()
        self._model, self._size, self._camera = model, size, camera
        self._context: Any = None
        self._one_at_a_time = threading.Lock()
        self._picture: Any = None
        if self.how == DRAWN:
            return
        if not self._has_windows():
            raise RuntimeError(
                "GLFW opens its windows on the main thread alone, and this is another: render one "
                "image there first, or set MUJOCO_GL=disable to draw by matplotlib"
            )
        with _WINDOWS:
            while _kept:
                _kept.pop().free()
            try:
                self._open()
            except (ImportError, RuntimeError, AttributeError):
                self.close()  # this process already uses another OpenGL backend
                self.how = DRAWN

    def _has_windows(self) -> bool:
        """Tells whether this thread can make and destroy what the backend renders into."""
        main = threading.current_thread() is threading.main_thread()
        return self.how != "glfw" or main or platform.system() == "Linux"

    def _open(self) -> None:
        # not mujoco.Renderer, whose backend is fixed when mujoco is imported
        engine, (width, height) = mujoco(), self._size
        self._context = importlib.import_module(f"mujoco.{self.how}").GLContext(width, height)
        self._context.make_current()
        self._picture = engine.MjrContext(self._model, engine.mjtFontScale.mjFONTSCALE_100.value)
        engine.mjr_setBuffer(engine.mjtFramebuffer.mjFB_OFFSCREEN.value, self._picture)
        self._scene = engine.MjvScene(self._model, maxgeom=400)
        self._scene.flags[engine.mjtRndFlag.mjRND_REFLECTION] = 0
        self._scene.flags[engine.mjtRndFlag.mjRND_SHADOW] = 0
        self._view, self._options = engine.MjvCamera(), engine.MjvOption()
        self._view.type = engine.mjtCamera.mjCAMERA_FIXED
        self._view.fixedcamid = self._model.camera(self._camera).id
        self._release()

    def paint(self, model: Any, data: Any, state: Array) -> NDArray[np.uint8]:
        """Render an `MjModel` with its `MjData` in `state` (columns,): (height, width, 3) uint8."""
        if self._context is None:
            from cotlearn.robots.arm.drawing import draw_picture  # late: it loads matplotlib

            return draw_picture(skeleton(data.qpos[None])[0], state, self._size, self._camera)
        with self._one_at_a_time:
            self._context.make_current()
            try:
                return self._rendered(model, data)
            finally:
                self._release()

    def _rendered(self, model: Any, data: Any) -> NDArray[np.uint8]:
        engine, (width, height) = mujoco(), self._size
        category = engine.mjtCatBit.mjCAT_ALL.value
        engine.mjv_updateScene(model, data, self._options, None, self._view, category, self._scene)
        area = engine.MjrRect(0, 0, width, height)
        engine.mjr_render(area, self._scene, self._picture)
        image = np.empty((height, width, 3), dtype=np.uint8)
        engine.mjr_readPixels(image, None, area, self._picture)
        return np.ascontiguousarray(image[::-1])

    def _release(self) -> None:
        """Lets the context go: another thread can then make it its own, and EGL allows no two."""
        if self.how == "egl":
            EGL = importlib.import_module("OpenGL.EGL")
            display = importlib.import_module("mujoco.egl").EGL_DISPLAY
            nothing = EGL.EGL_NO_SURFACE, EGL.EGL_NO_SURFACE, EGL.EGL_NO_CONTEXT
            EGL.eglMakeCurrent(display, *nothing)
        elif self.how == "glfw":
            importlib.import_module("glfw").make_context_current(None)

    def close(self) -> None:
        """Frees the resources of the graphics library; may be called twice."""
        with _WINDOWS:
            if self._context is not None:
                with contextlib.suppress(Exception):  # one that could not be opened
                    self._context.make_current()
            if self._picture is not None:
                self._picture.free()
            if self._context is not None:
                if self._has_windows():
                    self._context.free()
                else:
                    self._release()
                    _kept.append(self._context)
            self._picture = self._context = None
