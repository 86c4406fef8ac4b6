"""A session with QGIS's core, Processing and our plugin loaded as it is in a profile: as the package "repm"."""

from __future__ import annotations

import gc
import importlib
import os
import pathlib
import subprocess
import sys

import pytest

ROOT = pathlib.Path(__file__).resolve().parents[2]

os.environ.setdefault("QT_QPA_PLATFORM", "offscreen")
pytest.importorskip("qgis.core", reason="QGIS's Python modules are not visible here: run 'make setup'")


@pytest.fixture(scope="session")
def plugin(tmp_path_factory):
    """The plugin, loaded and registered without a desktop; unloaded, and QGIS ended, at the end."""
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

    project = QgsProject()

    def run(name, parameters, layers):
        context = QgsProcessingContext()
        context.setProject(project)
        given = {
            **parameters,
            **{key: QgsProcessingOutputLayerDefinition(str(path), project) for key, path in layers.items()},
        }
        algorithm = QgsApplication.processingRegistry().algorithmById(f"repm:{name}")
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

    def start(*arguments, config=config, **variables):
        # The tests' own interpreter must not tell qgis_process where Python is.
        environment = {name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "QGIS_"))}
        environment.update(REPM_QGIS_CONFIG=str(config), **variables)
        return subprocess.Popen(
            [str(ROOT / "scripts" / "qgis-headless"), *map(str, arguments)],
            env=environment,
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


def _truth_scene(folder, size):
    from repm_qgis.progress import Silent
    from repm_qgis.stages import run_stage

    return run_stage("sampledata", {"folder": str(folder), "kind": "urban", "size": size, "seed": 7}, Silent())


@pytest.fixture(scope="session")
def sample(tmp_path_factory):
    """A small truth scene: {"images": [...], "truth": ..., ...}."""
    return _truth_scene(tmp_path_factory.mktemp("sample"), 256)


@pytest.fixture(scope="session")
def town(tmp_path_factory):
    """A truth scene that is large enough for a DSM."""
    return _truth_scene(tmp_path_factory.mktemp("town"), 500)
