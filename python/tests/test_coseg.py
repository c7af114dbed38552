"""Tests of the wheel: `python -m unittest discover python/tests`. COSEG_PROGRAM names a `coseg` program to compare with."""

import functools
import gc
import hashlib
import json
import logging
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
import unittest
from pathlib import Path

import numpy as np

import coseg
import small_scene

SHORT = {
    "building.iterations": 40,
    "segmentation.iterations": 20,
    "segmentation.rows": ["raw", "vote", "per_gaussian"],
}
# A CPU, where equal runs have equal bits.
train = functools.partial(coseg.train, backend="flex")
vote = functools.partial(coseg.vote, backend="flex")
lift = functools.partial(coseg.lift, backend="flex")
# Warnings of such short runs are expected.
logging.getLogger("coseg").addHandler(logging.NullHandler())

PROGRAM = os.environ.get("COSEG_PROGRAM")


def program(*arguments):
    """Runs the `coseg` program."""
    return subprocess.run([PROGRAM, *map(str, arguments)], capture_output=True, text=True)


class WithScene(unittest.TestCase):
    """A small scene folder, a short run of it, and the events of that run."""

    @classmethod
    def setUpClass(cls):
        folder = tempfile.TemporaryDirectory()
        cls.addClassCleanup(folder.cleanup)
        cls.folder = Path(folder.name)
        cls.data = small_scene.write(cls.folder / "data")
        cls.run_folder = cls.folder / "run"
        cls.events = []
        cls.run_of_scene = train(cls.data, out=cls.run_folder, set=SHORT, seed=3, callback=cls.events.append)

    def raises(self, text, call, *arguments, **named):
        with self.assertRaises(coseg.Error) as raised:
            call(*arguments, **named)
        self.assertIn(text, str(raised.exception))
        return str(raised.exception)


class Arrays(WithScene):
    def test_arrays_have_the_shapes_of_the_run(self):
        run = self.run_of_scene
        n = len(run)
        self.assertGreater(n, 50)
        shapes = {
            "means": (n, 3), "log_scales": (n, 3), "rotations": (n, 4), "opacity_logits": (n,), "labels": (n,),
            "identities": (n, 4),
        }
        for name, shape in shapes.items():
            self.assertEqual(getattr(run, name).shape, shape, name)
        self.assertEqual(run.sh.shape[::2], (n, 3))
        self.assertEqual((run.means.dtype, run.labels.dtype, run.origin.dtype), (np.float32, np.uint16, np.float64))
        self.assertEqual(run.classes, dict(enumerate(small_scene.NAMES, 1)))
        self.assertEqual(run.unlabelled, 0)
        # The best score of a Gaussian is its label.
        ids = np.array(list(run.classes))[run.identities.argmax(axis=1)]
        known = np.ptp(run.identities, axis=1) > 0
        np.testing.assert_array_equal(run.labels[known], ids[known])
        self.assertIsNone(run.feature_colors, "no variant of this run reads image features")

    def test_arrays_are_read_only_views_that_keep_their_scene_alive(self):
        run = coseg.load(self.run_folder)
        for name in ["means", "log_scales", "rotations", "opacity_logits", "sh", "labels", "identities"]:
            first, second = getattr(run, name), getattr(run, name)
            self.assertEqual(first.ctypes.data, second.ctypes.data, name)
            self.assertTrue(np.shares_memory(first, second), name)
            self.assertFalse(first.flags.owndata or first.flags.writeable, name)
            self.assertIs(first.base, run)
            with self.assertRaises(ValueError):
                first.flags.writeable = True
        means = run.means
        copy = means.copy()
        del run, first, second
        gc.collect()
        np.testing.assert_array_equal(means, copy)

    def test_means_are_those_of_the_file(self):
        header, content = (self.run_folder / "scene.ply").read_bytes().split(b"end_header\n", 1)
        names = [line.split()[1:] for line in header.decode().splitlines() if line.startswith("property")]
        types = {"float": "<f4", "double": "<f8", "ushort": "<u2"}
        rows = np.frombuffer(content, np.dtype([(name, types[kind]) for kind, name in names]))
        run = self.run_of_scene
        world = np.stack([rows[axis] for axis in "xyz"], axis=1)
        np.testing.assert_allclose(run.means + run.origin, world, atol=1e-5)
        np.testing.assert_array_equal(run.labels, rows["label"])
        np.testing.assert_array_equal(run.opacity_logits, rows["opacity"])


class Rendering(WithScene):
    def test_a_frame_shows_the_wall(self):
        run = self.run_of_scene
        self.assertEqual([name for name, camera in run.cameras.items() if camera.split == "test"], ["v2"])
        view = run.render("v2", depth=True)
        shape = (small_scene.HEIGHT, small_scene.WIDTH)
        self.assertEqual(view.rgb.shape, (*shape, 3))
        for array in [view.alpha, view.labels, view.depth]:
            self.assertEqual(array.shape, shape)
            self.assertFalse(array.flags.writeable)
        self.assertEqual(view.rgb.ctypes.data, view.rgb.ctypes.data)
        self.assertIsNone(run.render("v2").depth)
        true = small_scene.labels(2)
        self.assertGreater((view.labels == true)[true > 0].mean(), 0.7)
        self.assertEqual(run.render("v2", size=(40, 32)).alpha.shape, (32, 40))
        white = run.render("v2", background=(1, 1, 1))
        expected = view.rgb + (1 - view.alpha)[..., None]
        np.testing.assert_allclose(white.rgb, expected, atol=1e-5)

    def test_a_camera_of_ones_own_renders_as_the_frame_that_it_equals(self):
        run = self.run_of_scene
        size = (small_scene.WIDTH, small_scene.HEIGHT)
        camera = coseg.Camera(small_scene.pose(2), (small_scene.FOCAL,) * 2, size)
        np.testing.assert_allclose(camera.pose, small_scene.pose(2), atol=1e-12)
        self.assertEqual((camera.size, camera.principal, camera.split), (size, (40.0, 32.0), None))
        np.testing.assert_allclose(run.render(camera).rgb, run.render("v2").rgb, atol=1e-4)
        self.raises("camera.pose", coseg.Camera, 2 * np.eye(4), (80, 80), size)
        self.raises("camera.width", coseg.Camera, np.eye(4), (80, 80), (0, 64))

    def test_threads_render_at_the_same_time(self):
        run = self.run_of_scene
        expected = run.render("v2").rgb
        seen = []
        threads = [threading.Thread(target=lambda: seen.append(run.render("v2").rgb)) for _ in range(4)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        self.assertEqual(len(seen), 4)
        for rgb in seen:
            np.testing.assert_array_equal(rgb, expected)

    @unittest.skipUnless(PROGRAM, "COSEG_PROGRAM names no program to compare with")
    def test_pictures_are_those_of_the_program(self):
        out = self.folder / "pictures"
        done = program(
            "render", "--scene", self.run_folder, "--out", out, "--split", "test", "--labels", "--depth",
            "--format", "npy", "--backend", "ndarray",
        )
        self.assertEqual(done.returncode, 0, done.stderr)
        view = self.run_of_scene.render("v2", depth=True, backend="ndarray")
        for kind, array in {"rgb": view.rgb, "alpha": view.alpha, "depth": view.depth}.items():
            np.testing.assert_array_equal(array, np.load(out / f"v2.{kind}.npy"), kind)


class Editing(WithScene):
    def test_objects_are_removed_moved_and_saved(self):
        run = self.run_of_scene
        red, blue = run.labels == 1, run.labels == 3
        edited = run.edit(remove="red", move={"blue": (0, 0, 0.5)})
        np.testing.assert_array_equal(edited.labels, run.labels[~red])
        np.testing.assert_allclose(edited.means[edited.labels == 3], run.means[blue] + [0, 0, 0.5], atol=1e-5)
        self.assertEqual(set(run.edit(keep=[1, "blue"]).labels), {1, 3})
        turned = run.edit(turn={"blue": ("z", 90)})
        again = run.edit(turn={3: ((0, 0, 2), 90.0)})
        np.testing.assert_array_equal(turned.means, again.means)
        self.assertFalse(np.array_equal(turned.means, run.means))
        self.assertIsNone(edited.identities)
        written = edited.save(self.folder / "edited")
        self.assertEqual(written, self.folder / "edited/scene.ply")
        loaded = coseg.load(written)
        np.testing.assert_allclose(loaded.means, edited.means, atol=1e-6)
        self.assertEqual(loaded.classes, run.classes)
        np.testing.assert_allclose(loaded.render("v2").rgb, edited.render("v2").rgb, atol=1e-5)
        edited.save(self.folder / "edited")
        # Not the scene of a run, by default.
        self.raises("--out: found", edited.save, self.run_folder)
        other = train(self.data, out=self.folder / "other", set=SHORT)
        self.raises("which this command did not write", edited.save, other.source)

    def test_edits_give_a_scene_its_first_labels(self):
        plain = self.folder / "plain.ply"
        header, content = (self.run_folder / "scene.ply").read_bytes().split(b"end_header\n", 1)
        size = len(content) // len(self.run_of_scene)
        rows = np.frombuffer(content, np.dtype(f"V{size}"))
        # The label comes last.
        plain.write_bytes(header.replace(b"property ushort label\n", b"") + b"end_header\n"
                          + rows.view(np.uint8).reshape(-1, size)[:, :-2].tobytes())
        scene = coseg.load(plain)
        self.assertIsNone(scene.labels)
        self.raises("column label", scene.edit, remove=1)
        edits = self.folder / "first.json"
        new = {"op": "assign", "gaussians": [0, 3], "object": 9, "new": {"name": "rug", "color": [1, 2, 3]}}
        digest = hashlib.sha256(plain.read_bytes()).hexdigest()
        edits.write_text(json.dumps({"version": 1, "scene": digest, "operations": [new]}))
        labelled = scene.edit(edits=edits)
        np.testing.assert_array_equal(np.flatnonzero(labelled.labels == 9), [0, 3])
        self.assertEqual(labelled.classes[9], "rug")

    def test_keeping_nothing_is_an_error(self):
        self.raises("no object", self.run_of_scene.edit, keep=[], remove=1)

    def test_edits_belong_to_a_file(self):
        edits = self.folder / "edits.json"
        edits.write_text('{"version": 1, "scene": "0", "operations": []}')
        self.raises("SHA-256", self.run_of_scene.edit, edits=edits)
        made = self.run_of_scene.edit(remove="red")
        self.raises("a scene that is in no file", made.edit, edits=edits)
        self.raises("no operation", self.run_of_scene.edit)
        self.raises("keep, remove", self.run_of_scene.edit, keep="red", edits=edits)


class Voting(WithScene):
    def test_votes_give_labels_and_weights(self):
        for pooled in [False, True]:
            voted = vote(self.run_folder, self.data, pooled=pooled)
            self.assertEqual(voted.identities.shape, (len(voted), 4))
            self.assertEqual(voted.classes, self.run_of_scene.classes)
            true = small_scene.labels(2)
            seen = voted.render("v2").labels
            self.assertEqual(voted.edit(keep="red").cameras, voted.cameras)
            self.assertGreater((seen == true)[true > 0].mean(), 0.7)

    def test_a_vote_is_saved_with_the_cameras_of_the_photos(self):
        bare = self.folder / "bare"
        bare.mkdir()
        (bare / "scene.ply").write_bytes((self.run_folder / "scene.ply").read_bytes())
        voted = vote(bare, self.data)
        voted.save(self.folder / "saved_vote")
        again = coseg.load(self.folder / "saved_vote")
        np.testing.assert_array_equal(again.render("v2").rgb, voted.render("v2").rgb)

    def test_features_are_lifted_onto_the_gaussians(self):
        lifted = lift(self.run_folder, self.data, set={"features.dimensions": 8, "features.scales": 2})
        self.assertEqual([scale.shape for scale in lifted.features], [(len(lifted), 8)] * 2)
        for scale in lifted.features:
            self.assertTrue(np.isfinite(scale).all())
            self.assertGreater(np.any(scale != 0, axis=1).mean(), 0.9)
            self.assertFalse(scale.flags.writeable)
        # Quarters have one colour each, so their features tell them apart.
        finest, labels = lifted.features[0], self.run_of_scene.labels
        means = np.array([finest[labels == label].mean(axis=0) for label in [1, 2, 3, 4]])
        nearest = np.linalg.norm(finest[:, None] - means, axis=2).argmin(axis=1) + 1
        self.assertGreater((nearest == labels)[labels > 0].mean(), 0.6)
        self.assertIsNone(self.run_of_scene.features)

    @unittest.skipUnless(PROGRAM, "COSEG_PROGRAM names no program to compare with")
    def test_labels_are_those_of_the_program(self):
        out = self.folder / "voted"
        done = program("vote", "--scene", self.run_folder, "--data", self.data, "--out", out, "--backend", "ndarray")
        self.assertEqual(done.returncode, 0, done.stderr)
        voted = coseg.vote(self.run_folder, self.data, backend="ndarray")
        np.testing.assert_array_equal(voted.labels, coseg.load(out).labels)


class Training(WithScene):
    def test_events_tell_the_course_of_a_run(self):
        kinds = [event.kind for event in self.events]
        for kind in ["started", "step", "evaluated", "scored", "finished"]:
            self.assertIn(kind, kinds)
        started = self.events[kinds.index("started")]
        self.assertEqual((started.step, started.total), (0, 40))
        steps = [event for event in self.events if event.kind == "step" and event.stage == started.stage]
        self.assertEqual([event.step for event in steps], list(range(1, 41)))
        self.assertTrue(all(np.isfinite(event.loss) and event.gaussians > 0 for event in steps))
        held_out = self.events[kinds.index("evaluated")]
        self.assertGreater(held_out.psnr, 5)
        rows = {event.variant: event.miou for event in self.events if event.kind == "scored"}
        self.assertEqual(len(rows), 3)

    def test_a_callback_stops_a_run_that_another_call_continues(self):
        out = self.folder / "stopped"
        steps = []

        def ten_steps(event):
            steps.extend([event.step] if event.kind == "step" else [])
            return len(steps) < 10

        self.assertIsNone(train(self.data, out=out, set=SHORT, seed=3, callback=ten_steps))
        self.assertEqual(steps, list(range(1, 11)))
        self.assertFalse((out / "identities.safetensors").exists())
        first = []
        run = train(resume=out, callback=lambda event: first.append(event))
        self.assertEqual((first[0].kind, first[0].step), ("started", 10))
        self.assertEqual(run.means.shape, self.run_of_scene.means.shape)
        np.testing.assert_array_equal(run.means, self.run_of_scene.means)

    def test_gaussians_of_a_scene_are_labelled(self):
        run = train(self.data, scene=self.run_folder, out=self.folder / "labelled", set={**SHORT, "building.iterations": 0})
        given = coseg.load(self.run_folder)
        order = [np.lexsort(scene.means.T) for scene in (run, given)]
        np.testing.assert_allclose(run.means[order[0]] + run.origin, given.means[order[1]] + given.origin, atol=1e-5)
        self.raises("expected data, set, backend and callback alone", train, resume=self.run_folder, scene=self.run_folder)

    def test_a_run_that_reads_image_features_keeps_their_colours(self):
        rows = {**SHORT, "segmentation.rows": "ours", "segmentation.iterations": 2}
        colors = train(self.data, scene=self.run_folder, out=self.folder / "ours", set={**rows, "building.iterations": 0}).feature_colors
        self.assertEqual(colors.shape, (len(self.run_of_scene), 3))
        self.assertTrue(0 <= colors.min() < colors.max() <= 1 and not colors.flags.writeable)

    def test_exceptions_pass_through_a_run(self):
        out = self.folder / "raised"

        def fails(event):
            if event.kind == "step" and event.step == 5:
                raise KeyError("of the callback")

        with self.assertRaisesRegex(KeyError, "of the callback"):
            train(self.data, out=out, set=SHORT, callback=fails)
        self.assertTrue(list((out / "checkpoint").iterdir()))
        self.raises("found a run", train, self.data, out=out)
        self.raises("resume", train, resume=out, seed=1)

    @unittest.skipIf(sys.platform == "win32", "signals of POSIX")
    def test_an_interrupt_stops_a_run_with_a_checkpoint(self):
        out = self.folder / "interrupted"
        # Programs in the background start with this signal ignored.
        before = signal.signal(signal.SIGINT, signal.default_int_handler)
        self.addCleanup(signal.signal, signal.SIGINT, before)

        def interrupts(event):
            if event.kind == "step" and event.step == 5:
                os.kill(os.getpid(), signal.SIGINT)

        with self.assertRaises(KeyboardInterrupt):
            train(self.data, out=out, set=SHORT, callback=interrupts)
        self.assertTrue(list((out / "checkpoint").iterdir()))
        self.assertIsNotNone(train(resume=out))

    def test_other_threads_run_during_training(self):
        ticks = []
        done = threading.Event()

        def tick():
            while not done.wait(0.002):
                ticks.append(time.perf_counter())

        thread = threading.Thread(target=tick)
        thread.start()
        start = time.perf_counter()
        train(self.data, out=self.folder / "beside", set=SHORT)
        end = time.perf_counter()
        done.set()
        thread.join()
        self.assertGreater(sum(start < tick < end for tick in ticks), 10)

    def test_warnings_are_logged(self):
        bare = small_scene.write(self.folder / "bare")
        text = (bare / "transforms.json").read_text().replace("raw_label_path", "comment")
        (bare / "transforms.json").write_text(text)
        with self.assertLogs("coseg", logging.WARNING) as logged:
            train(bare, out=self.folder / "unlabelled", set=SHORT)
        self.assertTrue(any("no training view has raw labels" in line for line in logged.output), logged.output)


class Errors(WithScene):
    CASES = {
        "no such file": (
            lambda folder: coseg.load(folder / "nothing.ply"),
            ["render", "--scene", "nothing.ply", "--out", "o"],
        ),
        "an object that is not there": (
            lambda folder: coseg.load(folder / "run").edit(remove="lamp"),
            ["edit", "--scene", "run", "--out", "o", "--remove", "lamp"],
        ),
        "an unknown setting": (
            lambda folder: train(folder / "data", set={"building.iteration": 3}, out=folder / "o"),
            ["train", "--data", "data", "--set", "building.iteration=3", "--out", "o"],
        ),
        "a setting out of range": (
            lambda folder: vote(folder / "run", folder / "data", set={"raster.alpha_max": 2.0}),
            ["vote", "--scene", "run", "--data", "data", "--set", "raster.alpha_max=2.0", "--out", "o"],
        ),
        "no scene folder": (
            lambda folder: train(folder / "nothing", out=folder / "o"),
            ["train", "--data", "nothing", "--out", "o"],
        ),
        "labels that differ from view to view": (
            lambda folder: vote(folder / "run", folder / "data", set={"data.association": "gaussians"}),
            ["vote", "--scene", "run", "--data", "data", "--set", "data.association=gaussians", "--out", "o"],
        ),
    }

    @unittest.skipUnless(PROGRAM, "COSEG_PROGRAM names no program to compare with")
    def test_errors_have_the_text_of_the_program(self):
        for name, (call, arguments) in self.CASES.items():
            with self.subTest(name):
                text = self.raises("", call, self.folder)
                paths = {"nothing.ply", "run", "data", "o", "nothing"}
                arguments = [self.folder / word if word in paths else word for word in arguments]
                done = program(*arguments)
                self.assertNotEqual(done.returncode, 0)
                self.assertIn(f"error: {text}", done.stderr.splitlines())

    def test_damaged_files_and_wrong_arguments_raise(self):
        damaged = self.folder / "damaged.ply"
        damaged.write_bytes((self.run_folder / "scene.ply").read_bytes()[:-7])
        self.raises(str(damaged), coseg.load, damaged)
        self.raises("--frame: found v9, expected one of 6 frames", self.run_of_scene.render, "v9")
        self.raises("backend: found tpu", self.run_of_scene.render, "v2", backend="tpu")
        self.raises("--move: found blue", self.run_of_scene.edit, move={"blue": (float("nan"), 0, 0)})
        self.raises("--turn: found blue", self.run_of_scene.edit, turn={"blue": ("w", 90)})
        self.raises("alpha_max", self.run_of_scene.render, "v2", alpha_max=2.0)
        with self.assertRaises(TypeError):
            train(self.data, set={"seed": object()})
        self.assertTrue(issubclass(coseg.Error, Exception))


class Import(unittest.TestCase):
    def test_nothing_slow_happens_on_import(self):
        def seconds() -> float:
            start = time.perf_counter()
            subprocess.run([sys.executable, "-c", "import coseg"], check=True)
            return time.perf_counter() - start

        # The best of several counts, because other programs may keep the machine busy.
        took = seconds()
        for _ in range(9):
            took = took if took < 1 else min(took, seconds())
        print(f"import coseg, with the start of Python: {took:.2f} s", file=sys.stderr)
        self.assertLess(took, 1)


if __name__ == "__main__":
    unittest.main()
