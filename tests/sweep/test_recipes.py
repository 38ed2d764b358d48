"""The recipes for clusters: the script of Slurm is run with stand-ins for its commands, KubeRay's file is read."""

import os
import pathlib
import re
import shutil
import subprocess

import pytest
import yaml

from jaxnav.sweep import spec

RECIPES = pathlib.Path(__file__).parents[2] / "docs" / "sweeps"
SLURM, KUBERAY = RECIPES / "slurm.sh", RECIPES / "kuberay.yaml"
OPTIONS = {"--out", "--resume", "--engine", "--address", "--report"}  # of `jaxnav sweep`
BASH = shutil.which("bash")

pytestmark = pytest.mark.skipif(BASH is None, reason="there is no bash")


def document(kind):
    (found,) = [part for part in yaml.safe_load_all(KUBERAY.read_text()) if part["kind"] == kind]
    return found


def script(tmp_path):
    """The script in KubeRay's file, as a file."""
    path = tmp_path / "run.sh"
    path.write_text(document("ConfigMap")["data"]["run.sh"])
    return path


def stand_ins(folder, body):
    """A PATH on which these commands write down how they were called, then do what ``body`` says of them."""
    folder.mkdir()
    for name in ("srun", "ray", "jaxnav", "hostname", "sleep"):
        path = folder / name
        path.write_text(f'#!{BASH}\necho "{name} $*" >> "$CALLS"\n{body.get(name, "")}\n')
        path.chmod(0o755)
    return f"{folder}:{os.environ['PATH']}"


def run(path, arguments, tmp_path, body=None, nodes=3):
    """(exit code, calls) of a script. nodes: of Slurm's job, 0 without one."""
    calls = tmp_path / "calls"
    calls.unlink(missing_ok=True)
    shutil.rmtree(tmp_path / "bin", ignore_errors=True)
    usual = {
        "hostname": "case $1 in --all*) echo fe80::1 10.0.0.1 10.1.0.1 ;; *) echo 127.0.1.1 ;; esac",
        "srun": "exec tail -f /dev/null",
        # The sweep takes longer than what starts beside it.
        "jaxnav": 'until (($(grep --count ^srun "$CALLS") >= SRUNS)); do :; done',
    }
    body = usual | (body or {})
    environment = {
        "PATH": stand_ins(tmp_path / "bin", body), "CALLS": str(calls), "SLURM_JOB_ID": "123456",
        "SLURM_JOB_NUM_NODES": str(nodes), "SLURM_CPUS_PER_TASK": "16", "SLURMD_NODENAME": "node1",
        "SRUNS": str(min(nodes, 2)),
    }  # fmt: skip
    done = subprocess.run([BASH, path, *arguments], env=environment, timeout=60, capture_output=True, text=True)
    return done.returncode, calls.read_text().splitlines() if calls.exists() else []


def sweeps(calls):
    return [call for call in calls if call.startswith("jaxnav")]


@pytest.mark.parametrize("recipe", ["slurm", "kuberay"])
def test_scripts_parse(recipe, tmp_path):
    subprocess.run([BASH, "-n", SLURM if recipe == "slurm" else script(tmp_path)], check=True)


def test_slurm_starts_a_head_the_workers_and_the_sweep(tmp_path):
    out = tmp_path / "a sweep"
    code, calls = run(SLURM, ["my sweep.py", out], tmp_path)
    assert code == 0
    head, workers = sorted((call for call in calls if call.startswith("srun")), key=lambda call: "--head" not in call)
    assert "--nodes=1 --ntasks=1 --nodelist=node1" in head
    assert "--node-ip-address=10.0.0.1 --port=23456" in head
    assert "--nodes=2 --ntasks=2 --exclude=node1" in workers and "--address=10.0.0.1:23456" in workers
    assert sweeps(calls) == [f"jaxnav sweep my sweep.py --out {out} --engine ray --address auto"]


def test_slurm_with_one_node_has_no_workers(tmp_path):
    code, calls = run(SLURM, ["sweep.py", tmp_path / "out"], tmp_path, nodes=1)
    assert code == 0 and sum(call.startswith("srun") for call in calls) == 1 and sweeps(calls)


def test_slurm_goes_on_with_a_sweep_that_is_there(tmp_path):
    (tmp_path / "sweep.json").touch()
    _, calls = run(SLURM, ["sweep.py", tmp_path], tmp_path)
    assert sweeps(calls) == [f"jaxnav sweep sweep.py --out {tmp_path} --engine ray --address auto --resume"]


def test_slurm_waits_for_the_head_and_gives_up_without_it(tmp_path):
    late = {"ray": '[[ $(grep --count "ray status" "$CALLS") -gt 3 ]]'}
    code, calls = run(SLURM, ["sweep.py", tmp_path / "out"], tmp_path, late)
    assert code == 0 and calls.count("sleep 2") == 3 and sweeps(calls)
    code, calls = run(SLURM, ["sweep.py", tmp_path / "out"], tmp_path, {"ray": "exit 1"})
    assert code == 1 and not sweeps(calls)


def test_slurm_fails_as_the_sweep_does(tmp_path):
    assert run(SLURM, ["sweep.py", tmp_path / "out"], tmp_path, {"jaxnav": "exit 2"})[0] == 2


@pytest.mark.parametrize("arguments", [[], ["sweep.py"]])
def test_slurm_says_what_it_lacks(arguments, tmp_path):
    code, calls = run(SLURM, arguments, tmp_path)
    assert code != 0 and not calls


def test_kuberay_goes_on_with_a_sweep_that_is_there(tmp_path):
    path = script(tmp_path)
    path.write_text(path.read_text().replace("/sweeps/first", str(tmp_path / "first")))
    code, calls = run(path, [], tmp_path, nodes=0)
    line = f"jaxnav sweep /recipe/sweep.py --out {tmp_path / 'first'} --engine ray --address auto"
    assert code == 0 and calls == [line]
    (tmp_path / "first").mkdir()
    (tmp_path / "first" / "sweep.json").touch()
    assert run(path, [], tmp_path, nodes=0)[1] == [f"{line} --resume"]


def test_kuberay_has_the_fields_that_it_needs():
    job = document("RayJob")
    assert job["apiVersion"] == "ray.io/v1" and job["metadata"]["name"]
    cluster = job["spec"]["rayClusterSpec"]
    assert {"entrypoint", "rayClusterSpec"} <= set(job["spec"])
    # Those that ray-operator/apis/ray/v1/raycluster_types.go has without omitempty.
    assert {"rayStartParams", "template"} <= set(cluster["headGroupSpec"])
    for group in cluster["workerGroupSpecs"]:
        assert {"groupName", "minReplicas", "maxReplicas", "rayStartParams", "template"} <= set(group)
        assert group["minReplicas"] <= group["replicas"] <= group["maxReplicas"]
    for group in (cluster["headGroupSpec"], *cluster["workerGroupSpecs"]):
        assert all(isinstance(value, str) for value in group["rayStartParams"].values())


def test_kuberay_shares_its_volumes():
    cluster = document("RayJob")["spec"]["rayClusterSpec"]
    claim, recipe = document("PersistentVolumeClaim"), document("ConfigMap")
    assert claim["spec"]["accessModes"] == ["ReadWriteMany"]
    for group in (cluster["headGroupSpec"], *cluster["workerGroupSpecs"]):
        pod = group["template"]["spec"]
        volumes = {volume["name"]: volume for volume in pod["volumes"]}
        (container,) = pod["containers"]
        mounts = {mount["mountPath"]: volumes[mount["name"]] for mount in container["volumeMounts"]}
        assert mounts["/sweeps"]["persistentVolumeClaim"]["claimName"] == claim["metadata"]["name"]
        assert mounts["/recipe"]["configMap"]["name"] == recipe["metadata"]["name"]
        assert container["resources"]["requests"] == container["resources"]["limits"]
    (gpus,) = [group["template"]["spec"]["containers"][0] for group in cluster["workerGroupSpecs"]]
    assert gpus["resources"]["limits"]["nvidia.com/gpu"] == "1"


def test_the_sweep_of_kuberay_can_be_run(tmp_path):
    path = tmp_path / "sweep.py"
    path.write_text(document("ConfigMap")["data"]["sweep.py"])
    sweep = spec.load(path)
    spec.check(sweep)
    (group,) = document("RayJob")["spec"]["rayClusterSpec"]["workerGroupSpecs"]
    assert sweep.populations == group["replicas"]


@pytest.mark.parametrize("path", [SLURM, KUBERAY], ids=["slurm", "kuberay"])
def test_recipes_use_options_that_there_are(path):
    text = path.read_text()
    given = re.findall(r"^\s*options\+?=\((.*)\)", text, flags=re.MULTILINE)
    given += re.findall(r"jaxnav sweep (.*)", text)
    used = {word for line in given for word in line.split() if word.startswith("-")}
    assert {"--out", "--resume", "--engine", "--address"} <= used <= OPTIONS
