"""The published covariance: what the whole trial says, and what a wrong sensor does to it."""

import numpy as np

from imu_rig.kernels.foot_covariance import ERRORS, N, smoothed_covariance
from imu_rig.rotation import from_rotation_vector, skew, to_matrix

G = 9.81


class Trial:
    """A short made-up trial with everything in it that the kernel knows of."""

    def __init__(self, n=36):
        rng = np.random.default_rng(5)
        self.n = n
        self.dt = rng.uniform(0.005, 0.02, n)
        self.dt[[0, 7]] = 0.0
        self.rate = rng.normal(0.0, 2.0, (n, 3))
        self.force = rng.normal((0.0, 0.0, G), 4.0, (n, 3))
        self.quaternion = from_rotation_vector(rng.normal(0.0, 0.6, (n, 3)))
        self.measured = np.zeros((n, 2))
        for first, last in ((0, 5), (14, 20), (29, n)):
            self.measured[first:last, 0] = rng.uniform(0.01, 0.05, last - first) ** 2
        self.measured[[3, 17, 32], 1] = 0.01**2
        self.unseen = np.zeros((n, 3))
        self.unseen[17], self.unseen[32, 0] = (4.0, 0.01**2, 0.3**2), 0.003**2
        self.model = np.array([0.01, 0.03, 0.02, 0.015, 1e-3, G, 0.01, -0.02, 0.08])
        spread = rng.normal(0.0, 0.003, (3, 3))
        self.errors = np.concatenate((spread.ravel(), [0.003, 0.004, 0.05, 0.002]))
        self.begin = np.zeros((N, N + ERRORS))
        variances = [0.03, 0.03, 0.0, 1, 1, 1, 0, 0, 0, 0.03, 0.03, 0.03, 3.0, 0.03, 0.03, 0.03]
        np.fill_diagonal(self.begin, np.square(variances))
        self.begin[:2, N:] = rng.normal(0.0, 0.01, (2, ERRORS))
        self.rows = np.array([0, 3, 10, 17, 25, 32, n - 1])
        self.falls = np.isin(self.rows, (3, 17, 32))

    def by_the_kernel(self):
        m = len(self.rows)
        out = np.empty((m, 9, 9)), np.empty((m, 9, ERRORS)), np.full((m, 3, 3), np.nan)
        readings = np.column_stack((self.dt, self.rate, self.force))
        smoothed_covariance(
            readings, self.quaternion, self.measured, self.unseen, self.model, self.errors,
            self.begin, self.rows, self.falls, *out,
        )  # fmt: skip
        return out

    def step(self, k):
        """Return transition, effect of constant errors, and variances of noise."""
        C0, C1 = to_matrix(self.quaternion[k - 1]), to_matrix(self.quaternion[k])
        C = 0.5 * (C0 + C1)
        a = 0.5 * (C0 @ self.force[k - 1] + C1 @ self.force[k])
        dt = self.dt[k]
        F, E = np.eye(N), np.zeros((N, ERRORS))
        rate_errors = np.zeros((3, ERRORS))
        rate_errors[:, :3] = self.errors[:9].reshape(3, 3)
        rate_errors[:, 3:12] = self.errors[9] * np.kron(np.eye(3), self.rate[k])
        force_errors = np.zeros((3, ERRORS))
        force_errors[:, 12:21] = self.errors[10] * np.kron(np.eye(3), self.force[k])
        force_errors[:, 21:24] = self.errors[11] * np.eye(3)
        F[3:6, 0:3], F[3:6, 9:12] = -dt * skew(a), -dt * C
        E[0:3], E[3:6] = -dt * C @ rate_errors, -dt * C @ force_errors
        E[0:3, 24] = -0.002 * C @ (self.rate[k] - self.rate[k - 1])
        F[6:9] += 0.5 * dt * F[3:6]
        F[6:9, 3:6] += 0.5 * dt * np.eye(3)
        E[6:9] = 0.5 * dt * E[3:6]
        Q = np.zeros(N)
        Q[0:3] = dt * (0.01**2 + 0.03**2 * self.rate[k] @ self.rate[k])
        a = a - (0.0, 0.0, G)
        Q[3:6] = dt * (0.02**2 + 0.015**2 * a @ a)
        Q[9:12] = dt * 1e-3**2
        Q[12] = self.unseen[k, 0]
        Q[0:3] += self.unseen[k, 1]
        Q[3:6] += self.unseen[k, 2]
        return F, E, Q

    def at_once(self):
        """Return the same by conditioning all samples on all measurements in one go."""
        n = self.n
        S = np.zeros((n, N, n, N))
        D = np.zeros((n, N, ERRORS))
        S[0, :, 0, :], D[0] = self.begin[:, :N], self.begin[:, N:]
        for k in range(1, n):
            F, E, Q = self.step(k)
            S[k, :, :k, :] = np.einsum("ij,jlm->ilm", F, S[k - 1, :, :k, :])
            S[:k, :, k, :] = S[k, :, :k, :].transpose(1, 2, 0)
            S[k, :, k, :] = F @ S[k - 1, :, k - 1, :] @ F.T + np.diag(Q)
            D[k] = F @ D[k - 1] + E
        S, D = S.reshape(n * N, n * N), D.reshape(n * N, ERRORS)
        H, R = [], []
        for k in range(n):
            C = to_matrix(self.quaternion[k])
            for part in range(3 if self.measured[k, 0] else 0):
                h = np.zeros((n, N))
                h[k, 0:3] = skew(C @ np.cross(self.rate[k], self.model[6:]))[part]
                h[k, 3 + part] = 1.0
                h[k, 13:16] = -(C @ skew(self.rate[k]))[part]
                H.append(h.ravel())
                R.append(self.measured[k, 0])
            if self.measured[k, 1]:
                h = np.zeros((n, N))
                h[k, 8], h[k, 12] = 1.0, -1.0
                H.append(h.ravel())
                R.append(self.measured[k, 1])
        H = np.array(H)
        gain = np.linalg.solve(H @ S @ H.T + np.diag(R), H @ S).T
        S, D = S - gain @ H @ S, D - gain @ H @ D
        return S.reshape(n, N, n, N), D.reshape(n, N, ERRORS)


def test_smoothing_back_is_conditioning_on_everything_at_once():
    trial = Trial()
    random, constant, between = trial.by_the_kernel()
    S, D = trial.at_once()
    for i, row in enumerate(trial.rows):
        np.testing.assert_allclose(random[i], S[row, :9, row, :9], rtol=1e-6, atol=1e-11)
        np.testing.assert_allclose(constant[i], D[row, :9], rtol=1e-6, atol=1e-11)
    p = slice(6, 9)
    for i, (a, b) in ((1, (3, 17)), (3, (17, 32))):
        away = S[b, p, b, p] + S[a, p, a, p] - S[a, p, b, p] - S[b, p, a, p]
        np.testing.assert_allclose(between[i], away, rtol=1e-6, atol=1e-11)
    assert np.isnan(between[5]).all()
