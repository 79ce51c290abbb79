"""Forward kinematics of the arm from the published description of the six-joint Kinova Gen3.

An implementation of its own: a chain of 4 x 4 matrices in double precision, joint after joint as the maker's URDF
(kortex_description, arms/gen3/6dof) states them, with two changes that the robot's documentation names: lengths are
scaled to the arm's reach, and the upper arm can turn about itself as on the seven-joint Gen3. The hand's yaw and pitch
are reached with the Gen3's joints 4, 5 and 6.

    python3 actor/simulator/tests/behaviour/reference/gen3_chain.py \
        > actor/simulator/tests/behaviour/reference/gen3_chain.json

writes the fixture that `robot.rs` compares with, and says on standard error what leaving out the sideways
steps between the joints' frames changes. Standard library only.
"""

import json
import math
import random
import sys

# Origin of each joint in the frame before it: xyz in metres, roll about x in radians (pitch and yaw are 0 throughout).
GEN3_JOINTS = [
    ((0.0, 0.0, 0.15643), math.pi),
    ((0.0, 0.005375, -0.12838), math.pi / 2),
    ((0.0, -0.41, 0.0), math.pi),
    ((0.0, 0.20843, -0.006375), math.pi / 2),
    ((0.0, -0.00017505, -0.10593), -math.pi / 2),
    ((0.0, 0.10593, -0.00017505), math.pi / 2),
]
LARGEST_SIDEWAYS_STEP = 0.007
REACH = 0.6335
SCALE = REACH / (0.41 + 0.20843 + 0.10593)
LIMITS_DEG = {2: 128.9, 3: 147.8, 5: 120.3}


def product(*matrices):
    result = matrices[0]
    for matrix in matrices[1:]:
        result = [[sum(row[k] * matrix[k][j] for k in range(4)) for j in range(4)] for row in result]
    return result


def translation(x, y, z):
    return [[1, 0, 0, x], [0, 1, 0, y], [0, 0, 1, z], [0, 0, 0, 1]]


def about(axis, angle):
    sin, cos = math.sin(angle), math.cos(angle)
    matrix = translation(0, 0, 0)
    one, two = (axis + 1) % 3, (axis + 2) % 3
    matrix[one][one], matrix[one][two], matrix[two][one], matrix[two][two] = cos, -sin, sin, cos
    return matrix


def origin(joint, sideways):
    xyz, roll = GEN3_JOINTS[joint - 1]
    kept = [SCALE * value if sideways or abs(value) > LARGEST_SIDEWAYS_STEP else 0.0 for value in xyz]
    return product(translation(*kept), about(0, roll))


# The URDF's base has its z axis along the base and bends towards x; the robot's shoulder frame has z along the base,
# y up. One quarter turn about z; then the base's length, so that the shoulder is the origin.
SHOULDER_FROM_BASE = product(translation(0.0, 0.0, -SCALE * (0.15643 + 0.12838)), about(2, math.pi / 2))


def wrist_joints(yaw, pitch):
    """Angles of joints 4, 5, 6 that turn the hand right by yaw and then down by pitch: z-x-z angles of that rotation."""
    turn = product(about(1, yaw), about(0, pitch))
    bend = math.atan2(math.hypot(turn[0][2], turn[1][2]), turn[2][2])
    if bend < 1e-9:
        return 0.0, 0.0, 0.0
    first = math.atan2(turn[0][2], -turn[1][2])
    last = math.atan2(turn[2][0], turn[2][1])
    # Joints 4 and 6 turn about axes that point back along the arm.
    return -first, bend, -last


def chain(base_roll, shoulder, upper_arm_roll, elbow, wrist_yaw, wrist_pitch, sideways=False):
    q4, q5, q6 = wrist_joints(wrist_yaw, wrist_pitch)
    # Joint 1 turns about an axis that points down into the base.
    frame = product(SHOULDER_FROM_BASE, origin(1, sideways), about(2, -base_roll))
    frame = product(frame, origin(2, sideways), about(2, shoulder))
    # The upper arm runs along this frame's negative y axis.
    frame = product(frame, about(1, -upper_arm_roll), origin(3, sideways))
    elbow_position = [row[3] for row in frame[:3]]
    frame = product(frame, about(2, elbow), origin(4, sideways), about(2, q4))
    frame = product(frame, origin(5, sideways), about(2, q5))
    wrist_position = [row[3] for row in frame[:3]]
    frame = product(frame, about(0, GEN3_JOINTS[5][1]), about(2, q6))
    return elbow_position, wrist_position, frame


def hand_axes(frame):
    """Axes x, y, z of the hand by the robot's names: with every joint at 0 they are those of the shoulder's frame."""
    rest = chain(0, 0, 0, 0, 0, 0)[2]
    return [[sum(frame[row][k] * rest[axis][k] for k in range(3)) for row in range(3)] for axis in range(3)]


def rounded(value):
    """To nine decimals: far below what single precision can tell, and without the last bits of one machine's sines."""
    if isinstance(value, dict):
        return {key: rounded(inner) for key, inner in value.items()}
    if isinstance(value, list):
        return [rounded(inner) for inner in value]
    return round(value, 9) + 0.0


def main():
    draw = random.Random(6)
    cases = []
    for number in range(64):
        # The first is the arm at rest.
        def angle(limit_deg):
            return math.radians(draw.uniform(-limit_deg, limit_deg)) if number else 0.0

        joints = [angle(180), abs(angle(LIMITS_DEG[2])), angle(180), abs(angle(LIMITS_DEG[3]))]
        joints += [angle(LIMITS_DEG[5]), angle(LIMITS_DEG[5])]
        elbow, wrist, frame = chain(*joints)
        cases.append({"joints_rad": joints, "elbow_m": elbow, "wrist_m": wrist, "hand_axes": hand_axes(frame)})
    moved = [math.dist(chain(*c["joints_rad"], sideways=True)[1], c["wrist_m"]) for c in cases]
    print(f"the sideways steps move the wrist by at most {1e3 * max(moved):.1f} mm", file=sys.stderr)
    lines = ",\n".join("  " + json.dumps(rounded(case)) for case in cases)
    print(f'{{"reach_m": {REACH}, "scale": {SCALE}, "cases": [\n{lines}\n]}}')


if __name__ == "__main__":
    main()
