"""Checks deploy/kubernetes/*.yaml and tries every command that lies in deploy/; called by deploy/check.

    check_manifests.py [ORCHESTRATOR]

Fields and types are compared with the models of Kubernetes, JobSet and Kubeflow Trainer (package kubeflow-trainer-api).
What no schema says is checked by hand: volumes, shared memory, restarts. With an orchestrator, its own command line
judges the options, and its doctor the size of /dev/shm. Then mistakes are planted, and each must be found.
"""

import copy
import importlib
import re
import shlex
import subprocess
import sys
from pathlib import Path

import yaml

DEPLOY = Path(__file__).resolve().parent
MODELS = {
    ("v1", "PersistentVolumeClaim"): "io_k8s_api_core_v1_persistent_volume_claim.IoK8sApiCoreV1PersistentVolumeClaim",
    ("jobset.x-k8s.io/v1alpha2", "JobSet"): "jobset_v1alpha2_job_set.JobsetV1alpha2JobSet",
    ("trainer.kubeflow.org/v1alpha1", "TrainJob"): "trainer_v1alpha1_train_job.TrainerV1alpha1TrainJob",
    ("trainer.kubeflow.org/v1alpha1", "ClusterTrainingRuntime"): (
        "trainer_v1alpha1_cluster_training_runtime.TrainerV1alpha1ClusterTrainingRuntime"
    ),
}
# Long enough to save a run: the work in progress, up to ten times what it usually takes (up to half a minute), and
# the ten minutes that a checkpoint waits for a disk that hangs. A test in
# orchestrator/src/supervisor/deadlines.rs compares it with these bounds.
GRACE_S = 1200
# Exit statuses of `orchestrator up` after which it must be started again.
START_AGAIN = {1, 7, 75}
UNITS = {"": 1, "k": 10**3, "M": 10**6, "G": 10**9, "T": 10**12, "Ki": 2**10, "Mi": 2**20, "Gi": 2**30, "Ti": 2**40}


def size(text):
    """Bytes of a quantity of Kubernetes, or of the doctor's figures."""
    match = re.fullmatch(r"([0-9.]+) ?([kMGT]?i?)B?", str(text))
    if match is None or match.group(2) not in UNITS:
        raise ValueError(f"`{text}` is no size")
    return float(match.group(1)) * UNITS[match.group(2)]


def lost(given, kept, place=""):
    """Fields of `given` that the model did not keep, because it does not know them, and those that are missing."""
    if isinstance(given, dict) and isinstance(kept, dict):
        for name, value in given.items():
            if name not in kept:
                yield f"{place}.{name}: no such field"
            else:
                yield from lost(value, kept[name], f"{place}.{name}")
        # The models fill in an empty word where a field is demanded.
        yield from (f"{place}.{name}: must be given" for name in kept if name not in given and kept[name] == "")
    elif isinstance(given, list) and isinstance(kept, list):
        for index, (one, other) in enumerate(zip(given, kept)):
            yield from lost(one, other, f"{place}[{index}]")


def by_schema(document):
    """What the API server would refuse, or silently drop."""
    key = (document.get("apiVersion"), document.get("kind"))
    if key not in MODELS:
        return [f"{key[0]} {key[1]}: no schema is known here"]
    module, name = MODELS[key].split(".")
    model = getattr(importlib.import_module(f"kubeflow_trainer_api.models.{module}"), name)
    try:
        kept = model.from_dict(copy.deepcopy(document)).to_dict()
    except (ValueError, TypeError, AttributeError, KeyError) as error:
        return [f"wrong type, or a field is missing: {error}"]
    return list(lost(document, kept))


def jobs(document):
    spec = document["spec"]
    spec = spec["template"]["spec"] if document["kind"] == "ClusterTrainingRuntime" else spec
    return [(spec, job["template"]["spec"]) for job in spec.get("replicatedJobs", [])]


def by_hand(document):
    """What fits the schema and is wrong all the same."""
    for jobset, job in jobs(document):
        pod = job["template"]["spec"]
        volumes = {volume["name"]: volume for volume in pod["volumes"]}
        if pod.get("terminationGracePeriodSeconds", 30) < GRACE_S:
            yield f"terminationGracePeriodSeconds is under {GRACE_S}: a run is killed while it saves"
        if (pod.get("restartPolicy"), job.get("backoffLimit")) != ("Never", 0):
            yield "restartPolicy and backoffLimit must be Never and 0: a host that starts again alone finds no others"
        if jobset.get("failurePolicy", {}).get("maxRestarts", 0) < 1:
            yield "failurePolicy.maxRestarts is 0: a lost host ends the run"
        containers = {container["name"]: container for container in pod["containers"]}
        for rule in job.get("podFailurePolicy", {}).get("rules", []):
            codes = rule.get("onExitCodes", {})
            if START_AGAIN & set(codes.get("values", [])):
                yield f"podFailurePolicy gives up after {sorted(codes['values'])}, and one of them means: start again"
            if codes.get("containerName", next(iter(containers))) not in containers:
                yield f"podFailurePolicy names no container: {codes['containerName']}"
        for container in containers.values():
            yield from by_hand_container(container, volumes)


def by_hand_container(container, volumes):
    mounts = {mount["mountPath"]: mount["name"] for mount in container["volumeMounts"]}
    for name in mounts.values():
        if name not in volumes:
            yield f"volumeMounts names no volume: {name}"
    shm = volumes.get(mounts.get("/dev/shm"), {}).get("emptyDir", {})
    if shm.get("medium") != "Memory" or "sizeLimit" not in shm:
        yield "/dev/shm is not a volume in memory with a sizeLimit"
    elif size(shm["sizeLimit"]) * 4 > size(container["resources"]["limits"]["memory"]):
        yield "the sizeLimit of /dev/shm is more than a quarter of the memory limit, which it counts towards"


def shared_memory(document):
    """What /dev/shm holds, bytes."""
    for _, job in jobs(document):
        for volume in job["template"]["spec"]["volumes"]:
            if volume.get("emptyDir", {}).get("medium") == "Memory":
                return size(volume["emptyDir"]["sizeLimit"])
    return None


def commands(documents):
    """(where, arguments, bytes of /dev/shm) of every command of the orchestrator that a file here starts."""
    room = {document["metadata"]["name"]: shared_memory(document) for document in documents if jobs_of(document)}
    for document in documents:
        if document["kind"] == "TrainJob":
            spec = document["spec"]
            yield document["kind"], spec["trainer"]["args"], room.get(spec["runtimeRef"]["name"])
        for _, job in jobs(document) if document["kind"] == "JobSet" else []:
            yield document["kind"], job["template"]["spec"]["containers"][0]["args"], shared_memory(document)
    unit = (DEPLOY / "systemd/stillroom@.service").read_text()
    words = re.search(r"^ExecStart=\S+ (.*)$", unit, re.MULTILINE).group(1)
    options = re.search(r"^STILLROOM_ARGS=(.*)$", (DEPLOY / "systemd/example.env").read_text(), re.MULTILINE).group(1)
    yield "stillroom@.service", shlex.split(words.replace("$STILLROOM_ARGS", options)), None


def jobs_of(document):
    return document["kind"] in ("JobSet", "ClusterTrainingRuntime") and jobs(document)


def tried(orchestrator, arguments, room):
    """What is wrong with a command: its options, and whether /dev/shm holds what it needs."""
    words = shlex.split(re.sub(r"--host-rank[= ]\S+", "--host-rank=99", " ".join(arguments)))
    # A host beyond the last: every option is read and judged, and nothing begins.
    plain = [re.sub(r"\$\(\w+\)", "2", word) for word in words]
    asked = subprocess.run([orchestrator, *plain], capture_output=True, text=True, timeout=60)
    if "host 99 of" not in asked.stderr:
        yield f"the orchestrator refuses it: {' '.join(arguments)}: {asked.stderr.strip()}"
        return
    if room is None:
        return
    known = [word for word in plain if re.match(r"--(preset|actors|learners|envs-per-actor)=", word)]
    report = subprocess.run([orchestrator, "doctor", *known], capture_output=True, text=True, timeout=120).stdout
    need = re.search(r"^shared memory +\S+ +([0-9.]+ \w+) of", report, re.MULTILINE)
    if not need:
        yield f"the doctor does not say what it needs in /dev/shm: {report.strip()}"
    elif size(need.group(1)) > room:
        yield f"the run needs {need.group(1)} in /dev/shm, and its sizeLimit is {room / 2**20:.0f} MiB"


def findings(documents, orchestrator):
    for document in documents:
        kind = document.get("kind")
        schema = by_schema(document)
        yield from (f"{kind}: {text}" for text in schema)
        if not schema:
            yield from (f"{kind}: {text}" for text in by_hand(document))
    if orchestrator:
        for where, arguments, room in commands(documents):
            yield from (f"{where}: {text}" for text in tried(orchestrator, arguments, room))


def set_in(document, path, value):
    for step in path[:-1]:
        document = document[step]
    if value is MISSING:
        del document[path[-1]]
    else:
        document[path[-1]] = value


MISSING = object()
JOB = ("spec", "replicatedJobs", 0, "template", "spec")
POD = (*JOB, "template", "spec")
# (kind, place, what is written there, part of what is found). The last ones need an orchestrator.
PLANTED = [
    ("JobSet", ("spec", "failurePolicies"), {"maxRestarts": 3}, "spec.failurePolicies: no such field"),
    ("JobSet", (*POD, "containers", 0, "volumeMount"), [], "containers[0].volumeMount: no such field"),
    ("JobSet", (*JOB, "backoffLimit"), "0", "wrong type"),
    ("JobSet", (*POD, "terminationGracePeriodSeconds"), "10m", "wrong type"),
    ("JobSet", (*POD, "containers", 0, "name"), MISSING, "containers[0].name: must be given"),
    ("JobSet", (*JOB, "backoffLimit"), 6, "Never and 0"),
    ("JobSet", (*POD, "terminationGracePeriodSeconds"), 30, "killed while it saves"),
    ("JobSet", (*JOB, "podFailurePolicy", "rules", 0, "onExitCodes", "values"), [2, 75], "start again"),
    ("JobSet", (*POD, "volumes", 0, "emptyDir"), {}, "not a volume in memory"),
    ("JobSet", (*POD, "volumes", 0, "emptyDir", "sizeLimit"), "20Gi", "a quarter of the memory limit"),
    ("JobSet", (*POD, "volumes", 0, "name"), "memory", "names no volume: shm"),
    ("TrainJob", ("spec", "trainer", "numNodes"), "two", "wrong type"),
    ("TrainJob", ("spec", "podTemplateOverrides"), [], "no such field"),
    ("TrainJob", ("spec", "runtimeRef"), MISSING, "wrong type"),
    ("ClusterTrainingRuntime", ("spec", "mlPolicy", "torch"), {"numProcPerNode": 1}, "torch.numProcPerNode: no such"),
    ("PersistentVolumeClaim", ("spec", "accessMode"), ["ReadWriteMany"], "spec.accessMode: no such field"),
    ("JobSet", ("apiVersion",), "jobset.x-k8s.io/v1", "no schema is known"),
    ("TrainJob", ("spec", "trainer", "args", 2), "--actor=38", "unexpected argument '--actor'"),
    ("JobSet", (*POD, "volumes", 0, "emptyDir", "sizeLimit"), "64Mi", "and its sizeLimit is 64 MiB"),
]


def missed(documents, orchestrator):
    """Planted mistakes that were not found."""
    for kind, path, value, expected in PLANTED:
        needs = expected.startswith(("unexpected", "and its"))
        if needs and not orchestrator:
            continue
        spoilt = copy.deepcopy(documents)
        set_in(next(document for document in spoilt if document["kind"] == kind), path, value)
        found = list(findings(spoilt, orchestrator if needs else None))
        if not any(expected in text for text in found):
            yield f"{kind} {'.'.join(map(str, path))} = {value} should give `{expected}`, and gave {found}"


def main():
    orchestrator = sys.argv[1] if len(sys.argv) > 1 else None
    paths = sorted((DEPLOY / "kubernetes").glob("*.yaml"))
    documents = [document for path in paths for document in yaml.safe_load_all(path.read_text())]
    found = [*findings(documents, orchestrator), *missed(documents, orchestrator)]
    for text in found:
        print(f"deploy: error: {text}", file=sys.stderr)
    if found or not documents:
        sys.exit(1)
    planted = f"{len(PLANTED)} planted mistakes" if orchestrator else "planted mistakes"
    print(f"{len(documents)} manifests keep to their schemas; {planted} were found")


main()
