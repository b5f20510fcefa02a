"""A robot drives a square five times; a function of ours registers the loops that the map asks for.

    PYTHONPATH=build/python python3 examples/python/compact_slam.py
"""

import numpy as np

import terse

SIGMA = np.array([0.05, 0.05, 0.01])  # of odometry and loops: metres, metres, radians
random = np.random.default_rng(1)
truth = [np.zeros(3)]  # [x, y, theta]; only the sensors see it
for step in range(1, 200):
    motion = [1.0, 0.0, np.pi / 2 if step % 10 == 9 else 0.0]
    x, y, theta = truth[-1]
    truth.append(np.array([x + np.cos(theta), y + np.sin(theta), theta + motion[2]]))


def measure(a, b):
    """What a scan matcher would do: the pose of b seen from a, with noise."""
    T_a_b = np.linalg.inv(terse.to_matrices(truth[a])) @ terse.to_matrices(truth[b])
    row = [T_a_b[0, 2], T_a_b[1, 2], np.arctan2(T_a_b[1, 0], T_a_b[0, 0])]
    return terse.RelativePose(a, b, row + SIGMA * random.standard_normal(3), covariance=SIGMA**2)


def register(candidate, current):
    """Called for the few pairs that are worth it; None where the two do not match."""
    return measure(candidate, current) if np.linalg.norm(truth[candidate][:2] - truth[current][:2]) < 3 else None


# The whole of compact pose SLAM.
options = terse.CompactOptions(2, range=[3, 3, 0.5], link_covariance=SIGMA**2, min_loop_gain=3, min_pose_gain=4)
slam = terse.CompactPoseSlam(options)
for k in range(len(truth)):
    decision = slam.add_pose(k, measure(k - 1, k) if k > 0 else None, register)
    if decision.links_accepted > 0:
        print(f"pose {k}: {decision.verdict}, {decision.links_accepted} links")
solution = slam.finish()
sigma = np.sqrt(np.diagonal(solution.marginals().marginal(int(solution.ids[-1]))))
error = np.linalg.norm(slam.trajectory().poses[:, :2] - np.array(truth)[:, :2], axis=1)

print(f"kept {slam.poses_kept} of {slam.poses_seen} poses and {slam.links_kept} links; chi2 {solution.chi2:.4g}")
print(f"the last kept pose is known to {sigma[0]:.3f} m, {sigma[1]:.3f} m, {sigma[2]:.4f} rad")
print(f"root mean square error of all poses: {np.sqrt(np.mean(error**2)):.3f} m")
