"""A session with QGIS's core, Processing and our plugin loaded as it is in a profile: as the package "repm"."""

from __future__ import annotations

import gc
import importlib
import json
import os
import pathlib
import shutil
import subprocess
import sys
import zipfile
from types import SimpleNamespace

import pytest

ROOT = pathlib.Path(__file__).resolve().parents[2]

os.environ.setdefault("QT_QPA_PLATFORM", "offscreen")
pytest.importorskip("qgis.core", reason="QGIS's Python modules are not visible here: run 'make setup'")


@pytest.fixture(scope="session", autouse=True)
def plugin(tmp_path_factory):
    """The plugin, loaded and registered without a desktop; unloaded, and QGIS ended, at the end.

    Every test has it: where a layer is made before QGIS has started, QGIS never finds its providers (no mesh is valid).
    """
    from qgis.core import QgsApplication

    profile = tmp_path_factory.mktemp("profile")
    os.environ["QGIS_CUSTOM_CONFIG_PATH"] = str(profile)
    os.environ.setdefault("XDG_RUNTIME_DIR", str(tmp_path_factory.mktemp("runtime")))
    plugins = tmp_path_factory.mktemp("plugins")
    (plugins / "repm").symlink_to(ROOT)
    application = QgsApplication([], False)
    application.initQgis()
    sys.path[:0] = [os.path.join(QgsApplication.pkgDataPath(), "python", "plugins"), str(plugins)]
    from processing.core.Processing import Processing

    Processing.initialize()
    loaded = importlib.import_module("repm").classFactory(None)
    loaded.initProcessing()
    yield loaded
    loaded.unload()
    Processing.deinitialize()
    application.exitQgis()


@pytest.fixture
def german(plugin):
    """The plugin's translator as it is in a German QGIS."""
    from qgis.core import QgsApplication, QgsSettings

    QgsSettings().setValue("locale/userLocale", "de_DE")
    plugin._install_translator()
    yield plugin
    QgsSettings().remove("locale/userLocale")
    if plugin.translator is not None:
        QgsApplication.removeTranslator(plugin.translator)
        plugin.translator = None


@pytest.fixture
def provider(plugin):
    return plugin.provider


@pytest.fixture
def context(plugin):
    from qgis.core import QgsProcessingContext

    return QgsProcessingContext()


class Ears:
    """A feedback that keeps what it hears."""

    def __new__(cls):
        from qgis.core import QgsProcessingFeedback

        class Feedback(QgsProcessingFeedback):
            def __init__(self):
                super().__init__(False)
                self.heard = {"info": [], "warning": [], "error": [], "text": [], "progress": []}
                self.progressChanged.connect(self.heard["progress"].append)

            def pushInfo(self, info):
                self.heard["info"].append(info)

            def pushWarning(self, warning):
                self.heard["warning"].append(warning)

            def reportError(self, error, fatalError=False):
                self.heard["error"].append(error)

            def setProgressText(self, text):
                self.heard["text"].append(text)

        return Feedback()


@pytest.fixture(scope="session")
def ears(plugin):
    """Makes a feedback that keeps what it hears."""
    return Ears


@pytest.fixture
def feedback(ears):
    return ears()


@pytest.fixture
def load(plugin, feedback):
    """Runs an algorithm as the dialog does, and gives its results and the layers by output name."""
    from processing.gui.Postprocessing import handleAlgorithmResults
    from qgis.core import QgsApplication, QgsProcessingContext, QgsProcessingOutputLayerDefinition, QgsProject
    from qgis.PyQt import sip

    project = QgsProject()
    # QGIS 3.40 crashes in the destructor of a project whose styles were asked for (removeProjectStyle). The desktop's
    # own one lives as long as QGIS; this one is never destroyed.
    sip.transferto(project, None)

    def run(name, parameters, layers):
        context = QgsProcessingContext()
        context.setProject(project)
        given = {
            **parameters,
            **{key: QgsProcessingOutputLayerDefinition(str(path), project) for key, path in layers.items()},
        }
        algorithm = QgsApplication.processingRegistry().algorithmById(f"repm:{name}")
        checked, problem = algorithm.checkParameterValues(given, context)
        assert checked, problem
        results, fine = algorithm.run(given, context, feedback)
        assert fine, feedback.heard["error"]
        gc.collect()  # a post-processor that only QGIS knows would be gone now
        assert handleAlgorithmResults(algorithm, context, feedback, parameters=given)
        by_source = {
            pathlib.Path(layer.source().split("|")[0]).resolve(): layer for layer in project.mapLayers().values()
        }
        return results, {key: by_source[pathlib.Path(path).resolve()] for key, path in layers.items()}

    run.project = project
    yield run
    project.clear()


@pytest.fixture(scope="session")
def headless_start(tmp_path_factory):
    """Starts scripts/qgis-headless in a configuration folder of this session's; gives the running process."""
    config = tmp_path_factory.mktemp("headless")

    def start(*arguments, config=config, cwd=None, **variables):
        # The tests' own interpreter must not tell qgis_process where Python is.
        environment = {name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "QGIS_"))}
        environment.update(REPM_QGIS_CONFIG=str(config), **variables)
        return subprocess.Popen(
            [str(ROOT / "scripts" / "qgis-headless"), *map(str, arguments)],
            env=environment,
            cwd=cwd,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )

    return start


@pytest.fixture(scope="session")
def headless(headless_start):
    """Runs scripts/qgis-headless; gives the finished process."""

    def run(*arguments, timeout=120, **keywords):
        process = headless_start(*arguments, **keywords)
        try:
            texts = process.communicate(timeout=timeout)
        except subprocess.TimeoutExpired:
            process.kill()
            raise
        return subprocess.CompletedProcess(process.args, process.returncode, *texts)

    return run


def unpack_plugin(plugins, place):
    """Put the plugin into a folder of plugins as its zip unpacks it: without .venv, and nothing is executable."""
    subprocess.run([sys.executable, str(ROOT / "scripts" / "package"), str(place)], check=True, stdout=subprocess.PIPE)
    with zipfile.ZipFile(next(pathlib.Path(place).glob("*.zip"))) as archive:
        archive.extractall(plugins)


@pytest.fixture
def unpacked_profile(tmp_path):
    """A configuration folder for qgis_process, with the unpacked plugin in its profile."""
    plugins = tmp_path / "config" / "profiles" / "default" / "python" / "plugins"
    plugins.mkdir(parents=True)
    unpack_plugin(plugins, tmp_path)
    return tmp_path / "config"


@pytest.fixture
def desktop_start(tmp_path):
    """Runs a driver of this folder in a new desktop with an empty profile; gives what it found.

    ``settings`` are lines of the profile's QGIS3.ini; without ``engine`` the plugin is its unpacked zip, which has
    none; with None there is no plugin. REPM_KEEP_PICTURES=FOLDER keeps the screenshots.
    """
    profile = tmp_path / "profiles" / "profiles" / "default"
    (profile / "python" / "plugins").mkdir(parents=True)
    (profile / "python" / "plugins" / "repm").symlink_to(ROOT)
    (profile / "QGIS").mkdir()
    (tmp_path / "runtime").mkdir(mode=0o700)
    out = tmp_path / "out"
    out.mkdir()

    def run(driver, plan, seconds=150, settings="[repm]\nfirst_steps_shown=true\n", locale="en", engine=True):
        enabled = "repm=true\n" if engine is not None else ""
        (profile / "QGIS" / "QGIS3.ini").write_text(
            f"[PythonPlugins]\n{enabled}processing=true\n[locale]\nuserLocale={locale}\noverrideFlag=true\n{settings}"
        )
        if not engine:
            (profile / "python" / "plugins" / "repm").unlink()
        if engine is False:
            unpack_plugin(profile / "python" / "plugins", tmp_path)
        path = tmp_path / "plan.json"
        path.write_text(json.dumps({**plan, "folder": str(out), "seconds": seconds}))
        environment = {
            name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "QGIS_", "QT_QPA"))
        }
        environment.update(REPM_DESKTOP_PLAN=str(path), REPM_ENGINE_PYTHON=sys.executable if engine else "")
        environment.update(REPM_DESKTOP_DRIVERS=str(ROOT / "tests" / "qgis"), HOME=str(tmp_path))
        environment.update(PYTHONFAULTHANDLER="1")  # a crash of QGIS is told with the place in Python
        environment.setdefault("XDG_RUNTIME_DIR", str(tmp_path / "runtime"))
        qgis = ["qgis", "--nologo", "--noversioncheck", "--profiles-path", str(tmp_path / "profiles")]
        done = subprocess.run(
            ["xvfb-run", "-a", "-s", "-screen 0 1400x900x24", *qgis, "--code", str(ROOT / "tests" / "qgis" / driver)],
            env=environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            timeout=seconds + 30,
            check=False,
        )
        assert (out / "found.json").exists(), f"QGIS ended with {done.returncode}:\n{done.stdout}"
        found = json.loads((out / "found.json").read_text())
        assert done.returncode == 0 and "error" not in found, f"{found}\n{done.stdout}"
        keep = os.environ.get("REPM_KEEP_PICTURES")
        for picture in out.glob("*.png") if keep else ():
            os.makedirs(keep, exist_ok=True)
            shutil.copy(picture, pathlib.Path(keep) / f"{found['name']}_{picture.name}")
        return found

    return run


def _truth_scene(folder, size):
    from repm_qgis.contracts.stages import SAMPLEDATA
    from repm_qgis.runtime.progress import Silent
    from repm_qgis.stages import run_stage

    options = {"folder": str(folder), "kind": "urban", "size": size, "seed": 7}
    return SimpleNamespace(**run_stage(SAMPLEDATA, options, Silent()).to_mapping())  # QGIS takes lists, no tuples


@pytest.fixture(scope="session")
def sample(tmp_path_factory):
    """A small truth scene: images, truth, gcps."""
    return _truth_scene(tmp_path_factory.mktemp("sample"), 256)


@pytest.fixture(scope="session")
def town(tmp_path_factory):
    """A truth scene that is large enough for a DSM."""
    return _truth_scene(tmp_path_factory.mktemp("town"), 500)
