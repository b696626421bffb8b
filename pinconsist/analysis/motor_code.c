/* NAME: from motors to all joints of MECHANISM, made by pinconsist.

   C99, with libm alone: no allocation, no state, and the same numbers for the same input. Units are SI.
   motors, v: NAMES_OF_MOTORS
   q: NAMES_IN_Q
   Free motions: NAMES_OF_FREE; held still by closure and jacobian, without torque in dynamics.

   NAME_closure    leads q, a closed configuration, to these positions of the motors, by NEWTON steps of Newton's.
   NAME_jacobian   A (NV, MOTORS), row by row: the velocities of all joints for unit ones of the motors.
   NAME_dynamics   M a + h = torques of the motors that move at v: M (MOTORS, MOTORS) and h (MOTORS).

   They return 0; 1 if the motors are too far away: go there in shorter steps; 2 if a singular position is there, or in
   between; 3 if a free motion has no inertia. A closure that does not return 0 leaves q as it was. */
#include <math.h>

int NAME_closure(const double *motors, double *q);
int NAME_jacobian(const double *q, double *A);
int NAME_dynamics(const double *q, const double *v, double *M, double *h);

/*CONSTANTS*/

/*FUNCTIONS*/

/* LU factors of a matrix (n, n) in place, with exchanges of rows: the sign of its determinant, 0 if singular. */
static int factorise(double *B, int *order, int n) {
  int i, j, k, sign = 1;
  for (k = 0; k < n; ++k) {
    int best = k;
    for (i = k + 1; i < n; ++i)
      if (fabs(B[i * n + k]) > fabs(B[best * n + k])) best = i;
    order[k] = best;
    for (j = 0; best != k && j < n; ++j) {
      const double above = B[k * n + j];
      B[k * n + j] = B[best * n + j];
      B[best * n + j] = above;
    }
    if (!(fabs(B[k * n + k]) > SMALLEST)) return 0;
    if ((B[k * n + k] < 0.0) != (best != k)) sign = -sign;
    for (i = k + 1; i < n; ++i) {
      B[i * n + k] /= B[k * n + k];
      for (j = k + 1; j < n; ++j) B[i * n + j] -= B[i * n + k] * B[k * n + j];
    }
  }
  return sign;
}

/* x becomes the solution for minus x. */
static void solve(const double *B, const int *order, int n, double *x) {
  int i, j;
  for (i = 0; i < n; ++i) {
    const double taken = x[order[i]];
    x[order[i]] = x[i];
    x[i] = -taken;
    for (j = 0; j < i; ++j) x[i] -= B[i * n + j] * x[j];
  }
  for (i = n - 1; i >= 0; --i) {
    for (j = i + 1; j < n; ++j) x[i] -= B[i * n + j] * x[j];
    x[i] /= B[i * n + i];
  }
}

/* phi and J, with factors of the columns that follow the motors. */
static int rows_at(const double *q, double *phi, double *J, double *B, int *order) {
  int i, j;
  rows(q, phi, J);
  for (i = 0; i < ROWS; ++i)
    for (j = 0; j < ROWS; ++j) B[i * ROWS + j] = J[i * NV + follow[j]];
  return factorise(B, order, ROWS);
}

/* What follows joins a change of q (phi is lost), which is then made; its size. */
static double move(const double *B, const int *order, double *phi, double *change, double *q) {
  double to[NQ], size = 0.0;
  int i;
  solve(B, order, ROWS, phi);
  for (i = 0; i < ROWS; ++i) change[follow[i]] = phi[i];
  for (i = 0; i < NV; ++i)
    if (!(fabs(change[i]) / sizes[i] <= size)) size = fabs(change[i]) / sizes[i];
  moved(q, change, to);
  for (i = 0; i < NQ; ++i) q[i] = to[i];
  return size;
}

int NAME_closure(const double *motors, double *q) {
  double x[NQ], phi[SPACE], J[SPACE * NV], B[SPACE * SPACE], change[NV] = {0.0}, way[MOTORS], step, size = 0.0;
  int order[SPACE], i, k, sign = rows_at(q, phi, J, B, order);
  if (!sign) return 2;
  to_go(q, motors, way);
  for (i = 0; i < NQ; ++i) x[i] = q[i];
  for (k = 0; k < MOTORS; ++k) change[lead[k]] = way[k];
  for (i = 0; i < ROWS; ++i)
    for (phi[i] = 0.0, k = 0; k < MOTORS; ++k) phi[i] += J[i * NV + lead[k]] * way[k];
  if (!((step = move(B, order, phi, change, x)) <= LONGEST_MOTION)) return 1;
  for (k = 0; k < MOTORS; ++k) change[lead[k]] = 0.0;
  for (k = 0; k < NEWTON; ++k) {
    if (rows_at(x, phi, J, B, order) != sign) return 2;
    size = move(B, order, phi, change, x);
    if (!(size <= ENOUGH || (k < NEWTON - 1 && size <= MISS * step))) return 1;
  }
  for (i = 0; i < NQ; ++i) q[i] = x[i];
  return 0;
}

/* The velocities for unit ones of motors, then of free motions: (NV, LEADS). */
static int basis(const double *q, double *Z, double *B, int *order) {
  double phi[SPACE], J[SPACE * NV];
  int i, k;
  if (!rows_at(q, phi, J, B, order)) return 2;
  for (i = 0; i < NV * LEADS; ++i) Z[i] = 0.0;
  for (k = 0; k < LEADS; ++k) {
    for (i = 0; i < ROWS; ++i) phi[i] = J[i * NV + lead[k]];
    solve(B, order, ROWS, phi);
    for (i = 0; i < ROWS; ++i) Z[follow[i] * LEADS + k] = phi[i];
    Z[lead[k] * LEADS + k] = 1.0;
  }
  return 0;
}

int NAME_jacobian(const double *q, double *A) {
  double Z[NV * LEADS], B[SPACE * SPACE];
  int order[SPACE], i, k;
  if (basis(q, Z, B, order)) return 2;
  for (i = 0; i < NV; ++i)
    for (k = 0; k < MOTORS; ++k) A[i * MOTORS + k] = Z[i * LEADS + k];
  return 0;
}

int NAME_dynamics(const double *q, const double *v, double *M, double *h) {
  double Z[NV * LEADS], B[SPACE * SPACE], x[SPACE], moving[NV] = {0.0}, a[NV] = {0.0}, load[NV];
  double all[LEADS * (LEADS + 1)] = {0.0}, F[LEADS * LEADS], y[LEADS];
  int order[SPACE], exchanged[LEADS], i, k, l;
  if (basis(q, Z, B, order)) return 2;
  for (i = 0; i < NV; ++i)
    for (k = 0; k < MOTORS; ++k) moving[i] += Z[i * LEADS + k] * v[k];
  drift(q, moving, x);
  solve(B, order, ROWS, x);
  for (i = 0; i < ROWS; ++i) a[follow[i]] = x[i];
  bias(q, moving, a, load);
  for (k = LEADS; k >= 0; --k) { /* the last column: forces; the others: inertia */
    for (i = 0; k < LEADS && i < NV; ++i) moving[i] = Z[i * LEADS + k];
    if (k < LEADS) inertia(q, moving, load);
    for (l = 0; l < LEADS; ++l)
      for (i = 0; i < NV; ++i) all[l * (LEADS + 1) + k] += Z[i * LEADS + l] * load[i];
  }
  for (k = 0; k < FREE; ++k) /* free motions follow without torque */
    for (l = 0; l < FREE; ++l) F[k * FREE + l] = all[(MOTORS + k) * (LEADS + 1) + MOTORS + l];
  if (!factorise(F, exchanged, FREE)) return 3;
  for (k = 0; k <= MOTORS; ++k) {
    const int from = k < MOTORS ? k : LEADS;
    for (l = 0; l < FREE; ++l) y[l] = all[(MOTORS + l) * (LEADS + 1) + from];
    solve(F, exchanged, FREE, y);
    for (i = 0; i < MOTORS; ++i) {
      double *left = k < MOTORS ? M + i * MOTORS + k : h + i;
      *left = all[i * (LEADS + 1) + from];
      for (l = 0; l < FREE; ++l) *left += all[i * (LEADS + 1) + MOTORS + l] * y[l];
    }
  }
  return 0;
}
