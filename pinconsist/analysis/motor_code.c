/* NAME: from motors to all joints of MECHANISM, made by pinconsist.

   C99, with libm alone: no allocation, no state, and the same numbers for the same input. Units are SI.
   motors, v: NAMES_OF_MOTORS
   q: NAMES_OF_Q
   free motions: NAMES_OF_FREE
   Free motions are held still by closure and jacobian, and have no torque in dynamics.

   NAME_closure    leads q, a closed configuration, to these positions of the motors, by NEWTON steps of Newton's.
   NAME_jacobian   A (NV, MOTORS), row by row: the velocities of all joints for unit ones of the motors.
   NAME_dynamics   M a + h = torques of the motors that move at v: M (MOTORS, MOTORS) and h (MOTORS).

   They return 0; 1 if the motors are too far away: go there in shorter steps; 2 if a singular position is there, or in
   between; 3 if a free motion has no inertia. A closure that does not return 0 leaves q as it was. */
#include <math.h>

int NAME_closure(const double *motors, double *q);
int NAME_jacobian(const double *q, double *A);
int NAME_dynamics(const double *q, const double *v, double *M, double *h);

/* A joint has the pose (R, p) on its parent at q = 0. Its numbers in q are `places` of a position, then `turns` of a
   rotation: 1, an angle (or the way along an axis); 2, cosine and sine; 4, a quaternion. Its body has a centre of mass
   and an inertia about it, in the axes of the joint. A place is a pose, or a point, on a joint. */
typedef struct { int parent, q, v, dofs, places, turns; double R[9], p[3], mass, com[3], inertia[9]; } Joint;
typedef struct { int joint; double R[9], p[3]; } Place;

/* A loop holds place 2 on place 1 by rows of these kinds: the component of d along a direction, (d.d / L - L) / 2, the
   turn about a direction, and the component of axis2; d is the way from place 1 to 2, in the axes of place 1. */
typedef enum { ALONG, LENGTH, TURN, TILT } Kind;
typedef struct { Kind kind; double direction[3]; } Row;
typedef struct { Place place[2]; double axis2[3], length; int first, last; } Loop;

/* A coupling: the sum of some shares of joints is a polynomial of that of others, up to whole periods if they wrap. */
typedef struct { int joint; double share; } Share;
typedef struct { int first, middle, last, law, end; double period; } Coupling;

/* Forces: a spring of a joint, dry friction of a velocity, a spring and damper between two points. */
typedef struct { int joint; double stiffness, rest; } JointSpring;
typedef struct { int v; double size, width; } Friction;
typedef struct { Place place[2]; double stiffness, length, damping; } SpringDamper;

/*TABLES*/

typedef struct { double R[JOINTS][9], p[JOINTS][3], linear[NV][3], angular[NV][3]; } Poses; /* in the world's axes */
typedef struct { double v[JOINTS][3], w[JOINTS][3], a[JOINTS][3], b[JOINTS][3]; } Motions; /* of the joints' origins */
typedef struct { double R1[9], R[9], x[3], d[3]; } Seen; /* place 2 at x in the world, and seen from place 1 */

static double dot(const double *a, const double *b) {
  return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

/* y += factor x */
static void add(double factor, const double *x, double *y) {
  int i;
  for (i = 0; i < 3; ++i) y[i] += factor * x[i];
}

/* y += a x b */
static void add_cross(const double *a, const double *b, double *y) {
  y[0] += a[1] * b[2] - a[2] * b[1];
  y[1] += a[2] * b[0] - a[0] * b[2];
  y[2] += a[0] * b[1] - a[1] * b[0];
}

/* y += w x (w x r) */
static void add_centripetal(const double *w, const double *r, double *y) {
  add(dot(w, r), w, y);
  add(-dot(w, w), r, y);
}

static void set(const double *x, double *y) {
  int i;
  for (i = 0; i < 3; ++i) y[i] = x[i];
}

static void set_zero(double *y, int n) {
  int i;
  for (i = 0; i < n; ++i) y[i] = 0.0;
}

/* y = R x */
static void turn(const double *R, const double *x, double *y) {
  int i;
  for (i = 0; i < 3; ++i) y[i] = dot(R + 3 * i, x);
}

/* y = R^T x */
static void turn_back(const double *R, const double *x, double *y) {
  int i;
  for (i = 0; i < 3; ++i) y[i] = R[i] * x[0] + R[3 + i] * x[1] + R[6 + i] * x[2];
}

/* C = A B */
static void product(const double *A, const double *B, double *C) {
  int i, j;
  for (i = 0; i < 3; ++i)
    for (j = 0; j < 3; ++j) C[3 * i + j] = A[3 * i] * B[j] + A[3 * i + 1] * B[3 + j] + A[3 * i + 2] * B[6 + j];
}

/* T = 1 + s [k] + c [k]^2 */
static void rotation(const double *k, double s, double c, double *T) {
  const double square = dot(k, k);
  int i, j;
  for (i = 0; i < 3; ++i)
    for (j = 0; j < 3; ++j) T[3 * i + j] = c * k[i] * k[j] + (i == j ? 1.0 - c * square : 0.0);
  T[1] -= s * k[2];
  T[3] += s * k[2];
  T[2] += s * k[1];
  T[6] -= s * k[1];
  T[5] -= s * k[0];
  T[7] += s * k[0];
}

/* The pose (T, shift) of a joint at its numbers x. */
static void displacement(const Joint *of, const double *x, double *T, double *shift) {
  const double *turned = x + of->places, *last = axes[of->v + of->dofs - 1];
  int i;
  for (i = 0; i < 3; ++i) shift[i] = i < of->places ? x[i] : 0.0;
  if (of->turns == 4) {
    rotation(turned, 2.0 * turned[3], 2.0, T);
  } else if (of->turns == 2) {
    rotation(last + 3, turned[1], 1.0 - turned[0], T);
  } else {
    const double angle = of->turns == 1 ? turned[0] : 0.0;
    rotation(last + 3, sin(angle), 1.0 - cos(angle), T);
    if (of->turns == 1) add(angle, last, shift);
  }
}

/* The poses of all joints, and the velocities for unit ones of each. */
static void place_joints(const double *q, Poses *at) {
  int i, k;
  set_zero(at->p[0], 3);
  set_zero(at->R[0], 9);
  at->R[0][0] = at->R[0][4] = at->R[0][8] = 1.0;
  for (i = 1; i < JOINTS; ++i) {
    const Joint *of = joints + i;
    double T[9], shift[3], R[9], way[3];
    displacement(of, q + of->q, T, shift);
    product(at->R[of->parent], of->R, R);
    product(R, T, at->R[i]);
    turn(at->R[of->parent], of->p, at->p[i]);
    add(1.0, at->p[of->parent], at->p[i]);
    turn(R, shift, way);
    add(1.0, way, at->p[i]);
    for (k = of->v; k < of->v + of->dofs; ++k) {
      turn(at->R[i], axes[k], at->linear[k]);
      turn(at->R[i], axes[k] + 3, at->angular[k]);
    }
  }
}

/* The motions of all joints at velocities and accelerations of their own. */
static void move_joints(const Poses *at, const double *v, const double *a, Motions *m) {
  int i, k;
  set_zero(m->v[0], 3);
  set_zero(m->w[0], 3);
  set_zero(m->a[0], 3);
  set_zero(m->b[0], 3);
  for (i = 1; i < JOINTS; ++i) {
    const int up = joints[i].parent;
    double r[3], u[3] = {0.0, 0.0, 0.0}, w[3] = {0.0, 0.0, 0.0}, twice[3];
    set(at->p[i], r);
    add(-1.0, at->p[up], r);
    set(m->v[up], m->v[i]);
    set(m->w[up], m->w[i]);
    set(m->a[up], m->a[i]);
    set(m->b[up], m->b[i]);
    for (k = joints[i].v; k < joints[i].v + joints[i].dofs; ++k) {
      add(v[k], at->linear[k], u);
      add(v[k], at->angular[k], w);
      add(a[k], at->linear[k], m->a[i]);
      add(a[k], at->angular[k], m->b[i]);
    }
    set(w, twice);
    add(2.0, m->w[up], twice);
    add(1.0, u, m->v[i]);
    add(1.0, w, m->w[i]);
    add_cross(m->w[up], r, m->v[i]);
    add_cross(m->b[up], r, m->a[i]);
    add_centripetal(m->w[up], r, m->a[i]);
    add_cross(twice, u, m->a[i]);
    add_cross(m->w[up], w, m->b[i]);
  }
}

/* row += the velocities along a force at x and a moment, on joint 2 and opposite on joint 1, for unit ones of joints */
static void add_wrench(const Poses *at, int one, int two, const double *x, const double *force, const double *moment,
                       double *row) {
  while (one != two) {
    const int first = one > two, i = first ? one : two;
    double about[3], r[3];
    int k;
    set(x, r);
    add(-1.0, at->p[i], r);
    set(moment, about);
    add_cross(r, force, about);
    for (k = joints[i].v; k < joints[i].v + joints[i].dofs; ++k) {
      const double along = dot(force, at->linear[k]) + dot(about, at->angular[k]);
      row[k] += first ? -along : along;
    }
    *(first ? &one : &two) = joints[i].parent;
  }
}

static void see(const Poses *at, const Place *place, Seen *seen) {
  double R2[9], away[3];
  int i, j, k;
  product(at->R[place[0].joint], place[0].R, seen->R1);
  product(at->R[place[1].joint], place[1].R, R2);
  turn(at->R[place[1].joint], place[1].p, seen->x);
  add(1.0, at->p[place[1].joint], seen->x);
  turn(at->R[place[0].joint], place[0].p, away);
  for (i = 0; i < 3; ++i) away[i] = seen->x[i] - at->p[place[0].joint][i] - away[i];
  turn_back(seen->R1, away, seen->d);
  for (i = 0; i < 3; ++i)
    for (j = 0; j < 3; ++j)
      for (seen->R[3 * i + j] = 0.0, k = 0; k < 3; ++k) seen->R[3 * i + j] += seen->R1[3 * k + i] * R2[3 * k + j];
}

/* The value of a row of a loop, and the force and moment on place 2 that it exerts, in the axes of place 1. */
static double row_of(const Loop *loop, const Row *row, const Seen *seen, double *force, double *moment) {
  const double *R = seen->R, *e = row->direction;
  double a[3];
  int i;
  set_zero(force, 3);
  set_zero(moment, 3);
  switch (row->kind) {
    case ALONG:
      set(e, force);
      return dot(e, seen->d);
    case LENGTH:
      add(1.0 / loop->length, seen->d, force);
      return 0.5 * (dot(seen->d, seen->d) / loop->length - loop->length);
    case TURN:
      for (i = 0; i < 3; ++i) moment[i] = 0.5 * ((R[0] + R[4] + R[8]) * e[i] - dot(R + 3 * i, e));
      return 0.5 * (e[0] * (R[7] - R[5]) + e[1] * (R[2] - R[6]) + e[2] * (R[3] - R[1]));
    case TILT:
    default:
      turn(R, loop->axis2, a);
      add_cross(a, e, moment);
      return dot(e, a);
  }
}

/* The position of a joint of one degree of freedom, beyond a target the shorter way round if it stores no turns. */
static double beyond(const double *q, int joint, double target) {
  const double *x = q + joints[joint].q;
  return joints[joint].turns == 2 ? remainder(atan2(x[1], x[0]) - target, WHOLE) : x[0] - target;
}

/* The derivative of some order, 0 to 2, of a coupling's polynomial. */
static double law_of(const Coupling *of, double x, int order) {
  double value = 0.0;
  int i;
  for (i = of->end - 1; i >= of->law + order; --i) {
    const int power = i - of->law;
    value = value * x + laws[i] * (order == 0 ? 1 : order == 1 ? power : power * (power - 1));
  }
  return value;
}

static double sum_of(const double *q, int first, int last) {
  double sum = 0.0;
  int i;
  for (i = first; i < last; ++i) sum += shares[i].share * beyond(q, shares[i].joint, 0.0);
  return sum;
}

static void rows(const Poses *at, const double *q, double *phi, double *J) {
  int i, k;
  set_zero(J, ROWS * NV);
  for (i = 0; i < LOOPS; ++i) {
    const Loop *loop = loops + i;
    Seen seen;
    see(at, loop->place, &seen);
    for (k = loop->first; k < loop->last; ++k) {
      double f[3], m[3], force[3], moment[3];
      phi[k] = row_of(loop, loop_rows + k, &seen, f, m);
      turn(seen.R1, f, force);
      turn(seen.R1, m, moment);
      add_wrench(at, loop->place[0].joint, loop->place[1].joint, seen.x, force, moment, J + k * NV);
    }
  }
  for (i = 0; i < COUPLINGS; ++i) {
    const Coupling *of = couplings + i;
    const int row = ROWS - COUPLINGS + i;
    const double other = sum_of(q, of->middle, of->last), slope = law_of(of, other, 1);
    const double gap = sum_of(q, of->first, of->middle) - law_of(of, other, 0);
    phi[row] = of->period > 0.0 ? remainder(gap, of->period) : gap;
    for (k = of->first; k < of->last; ++k)
      J[row * NV + joints[shares[k].joint].v] += shares[k].share * (k < of->middle ? 1.0 : -slope);
  }
}

/* The motion of the point of a joint's body that is at x. */
static void point_motion(const Poses *at, const Motions *m, int joint, const double *x, double *v, double *a) {
  double r[3];
  set(x, r);
  add(-1.0, at->p[joint], r);
  set(m->v[joint], v);
  add_cross(m->w[joint], r, v);
  set(m->a[joint], a);
  add_cross(m->b[joint], r, a);
  add_centripetal(m->w[joint], r, a);
}

/* The relative motion of place 2, seen from place 1: velocity, acceleration, angular velocity, angular acceleration. */
static void relative_motion(const Poses *at, const Motions *m, const Place *place, const Seen *seen, double way[4][3]) {
  const int one = place[0].joint, two = place[1].joint;
  double v1[3], a1[3], v[3], a[3], w[3], b[3];
  point_motion(at, m, one, seen->x, v1, a1);
  point_motion(at, m, two, seen->x, v, a);
  set(m->w[two], w);
  set(m->b[two], b);
  add(-1.0, v1, v);
  add(-1.0, a1, a);
  add(-1.0, m->w[one], w);
  add(-1.0, m->b[one], b);
  add_cross(v, m->w[one], a); /* Coriolis */
  add_cross(v, m->w[one], a);
  add_cross(w, m->w[one], b);
  turn_back(seen->R1, v, way[0]);
  turn_back(seen->R1, a, way[1]);
  turn_back(seen->R1, w, way[2]);
  turn_back(seen->R1, b, way[3]);
}

/* The second derivatives of closed rows at velocities v, without accelerations. */
static void drift(const Poses *at, const double *q, const double *v, double *rate) {
  static const double still[NV] = {0.0};
  Motions m;
  int i, k;
  move_joints(at, v, still, &m);
  for (i = 0; i < LOOPS; ++i) {
    const Loop *loop = loops + i;
    double way[4][3];
    Seen seen;
    see(at, loop->place, &seen);
    relative_motion(at, &m, loop->place, &seen, way);
    for (k = loop->first; k < loop->last; ++k) {
      double force[3], moment[3], a[3];
      (void)row_of(loop, loop_rows + k, &seen, force, moment);
      rate[k] = dot(force, way[1]) + dot(moment, way[3]);
      if (loop_rows[k].kind == LENGTH) rate[k] += dot(way[0], way[0]) / loop->length;
      if (loop_rows[k].kind != TILT) continue;
      turn(seen.R, loop->axis2, a);
      set_zero(force, 3);
      add_centripetal(way[2], a, force);
      rate[k] += dot(loop_rows[k].direction, force);
    }
  }
  for (i = 0; i < COUPLINGS; ++i) {
    const Coupling *of = couplings + i;
    double speed = 0.0;
    for (k = of->middle; k < of->last; ++k) speed += shares[k].share * v[joints[shares[k].joint].v];
    rate[ROWS - COUPLINGS + i] = -law_of(of, sum_of(q, of->middle, of->last), 2) * speed * speed;
  }
}

/* q moved by a change; quaternions to first order. */
static void moved(const double *q, const double *change, double *to) {
  int i, k;
  for (i = 1; i < JOINTS; ++i) {
    const Joint *of = joints + i;
    const double *x = q + of->q + of->places, *d = change + of->v;
    double *y = to + of->q + of->places;
    if (of->places > 0) {
      double T[9], shift[3], way[3] = {0.0, 0.0, 0.0}, turned[3];
      displacement(of, q + of->q, T, shift);
      for (k = 0; k < of->places; ++k) way[k] = d[k];
      turn(T, way, turned);
      for (k = 0; k < of->places; ++k) to[of->q + k] = shift[k] + turned[k];
    }
    d += of->dofs - (of->turns == 4 ? 3 : 1);
    if (of->turns == 1) {
      y[0] = x[0] + d[0];
    } else if (of->turns == 2) {
      const double c = cos(d[0]), s = sin(d[0]);
      y[0] = x[0] * c - x[1] * s;
      y[1] = x[1] * c + x[0] * s;
    } else if (of->turns == 4) {
      double size;
      set(x, y);
      add(0.5 * x[3], d, y);
      y[0] += 0.5 * (x[1] * d[2] - x[2] * d[1]);
      y[1] += 0.5 * (x[2] * d[0] - x[0] * d[2]);
      y[2] += 0.5 * (x[0] * d[1] - x[1] * d[0]);
      y[3] = x[3] - 0.5 * dot(x, d);
      size = sqrt(dot(y, y) + y[3] * y[3]);
      for (k = 0; k < 4; ++k) y[k] /= size;
    }
  }
}

/* The forces and moments on the bodies, at the origins of their joints, as forces in the joints. */
static void gather(const Poses *at, double force[JOINTS][3], double moment[JOINTS][3], double *load) {
  int i, k;
  for (i = JOINTS - 1; i > 0; --i) {
    const Joint *of = joints + i;
    double r[3];
    for (k = of->v; k < of->v + of->dofs; ++k)
      load[k] = dot(force[i], at->linear[k]) + dot(moment[i], at->angular[k]);
    set(at->p[i], r);
    add(-1.0, at->p[of->parent], r);
    add(1.0, force[i], force[of->parent]);
    add(1.0, moment[i], moment[of->parent]);
    add_cross(r, force[i], moment[of->parent]);
  }
}

/* The forces in the joints for velocities and accelerations under gravity. */
static void inverse_dynamics(const Poses *at, const double *v, const double *a, double *load) {
  double force[JOINTS][3] = {{0.0}}, moment[JOINTS][3] = {{0.0}};
  Motions m;
  int i, k;
  move_joints(at, v, a, &m);
  for (i = 1; i < JOINTS; ++i) {
    const Joint *of = joints + i;
    double r[3], f[3], w[3], b[3], spin[3], turned[3];
    turn(at->R[i], of->com, r);
    set(m.a[i], f);
    add(-1.0, gravity, f);
    add_cross(m.b[i], r, f);
    add_centripetal(m.w[i], r, f);
    add(of->mass, f, force[i]);
    turn_back(at->R[i], m.w[i], w);
    turn_back(at->R[i], m.b[i], b);
    turn(of->inertia, w, spin);
    turn(of->inertia, b, turned);
    add_cross(w, spin, turned);
    turn(at->R[i], turned, moment[i]);
    add_cross(r, force[i], moment[i]);
  }
  gather(at, force, moment, load);
  for (k = 0; k < NV; ++k) load[k] += armature[k] * a[k];
}

/* The momenta of the joints at velocities: their mass matrix times these. */
static void momenta(const Poses *at, const double *v, double *load) {
  double linear[JOINTS][3] = {{0.0}}, angular[JOINTS][3] = {{0.0}}, w[JOINTS][3] = {{0.0}}, u[JOINTS][3] = {{0.0}};
  int i, k;
  for (i = 1; i < JOINTS; ++i) {
    const Joint *of = joints + i;
    double r[3], own[3], spin[3];
    set(at->p[i], r);
    add(-1.0, at->p[of->parent], r);
    set(w[of->parent], w[i]);
    set(u[of->parent], u[i]);
    add_cross(w[i], r, u[i]);
    for (k = of->v; k < of->v + of->dofs; ++k) {
      add(v[k], at->linear[k], u[i]);
      add(v[k], at->angular[k], w[i]);
    }
    turn(at->R[i], of->com, r);
    set(u[i], own);
    add_cross(w[i], r, own);
    add(of->mass, own, linear[i]);
    turn_back(at->R[i], w[i], own);
    turn(of->inertia, own, spin);
    turn(at->R[i], spin, angular[i]);
    add_cross(r, linear[i], angular[i]);
  }
  gather(at, linear, angular, load);
  for (k = 0; k < NV; ++k) load[k] += armature[k] * v[k];
}

/* load -= the forces of springs, dampers, friction and constant torques */
static void subtract_applied(const Poses *at, const double *q, const double *v, double *load) {
  static const double none[3] = {0.0, 0.0, 0.0};
  int i, k;
  for (i = 0; i < NV; ++i) load[i] += damping[i] * v[i] - torque[i];
  for (i = 0; i < FRICTIONS; ++i) {
    const Friction *of = frictions + i;
    load[of->v] += of->size * tanh(v[of->v] / of->width);
  }
  for (i = 0; i < JOINT_SPRINGS; ++i) {
    const JointSpring *of = joint_springs + i;
    load[joints[of->joint].v] += of->stiffness * beyond(q, of->joint, of->rest);
  }
  for (i = 0; i < SPRINGS; ++i) {
    const SpringDamper *of = springs + i;
    double row[NV] = {0.0}, along[3], length, tension, speed = 0.0;
    Seen seen;
    see(at, of->place, &seen);
    length = sqrt(dot(seen.d, seen.d));
    turn(seen.R1, seen.d, along);
    for (k = 0; k < 3; ++k) along[k] /= length;
    add_wrench(at, of->place[0].joint, of->place[1].joint, seen.x, along, none, row);
    for (k = 0; k < NV; ++k) speed += row[k] * v[k];
    tension = of->stiffness * (length - of->length) + of->damping * speed;
    for (k = 0; k < NV; ++k) load[k] += tension * row[k];
  }
}

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

/* The poses, phi and J, with factors of the columns that follow the motors. */
static int rows_at(const double *q, Poses *at, double *phi, double *J, double *B, int *order) {
  int i, j;
  place_joints(q, at);
  rows(at, q, phi, J);
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
  Poses at;
  int order[SPACE], i, k, sign = rows_at(q, &at, phi, J, B, order);
  if (!sign) return 2;
  for (i = 0; i < NQ; ++i) x[i] = q[i];
  for (k = 0; k < MOTORS; ++k) {
    way[k] = -beyond(q, motor[k], motors[k]);
    change[lead[k]] = way[k];
  }
  for (i = 0; i < ROWS; ++i)
    for (phi[i] = 0.0, k = 0; k < MOTORS; ++k) phi[i] += J[i * NV + lead[k]] * way[k];
  if (!((step = move(B, order, phi, change, x)) <= LONGEST_MOTION)) return 1;
  for (k = 0; k < MOTORS; ++k) change[lead[k]] = 0.0;
  for (k = 0; k < NEWTON; ++k) {
    if (rows_at(x, &at, phi, J, B, order) != sign) return 2;
    size = move(B, order, phi, change, x);
    if (!(size <= ENOUGH || (k < NEWTON - 1 && size <= MISS * step))) return 1;
  }
  for (i = 0; i < NQ; ++i) q[i] = x[i];
  return 0;
}

/* The velocities for unit ones of motors, then of free motions: (NV, LEADS). */
static int basis(const double *q, Poses *at, double *Z, double *B, int *order) {
  double phi[SPACE], J[SPACE * NV];
  int i, k;
  if (!rows_at(q, at, phi, J, B, order)) return 2;
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
  Poses at;
  int order[SPACE], i, k;
  if (basis(q, &at, Z, B, order)) return 2;
  for (i = 0; i < NV; ++i)
    for (k = 0; k < MOTORS; ++k) A[i * MOTORS + k] = Z[i * LEADS + k];
  return 0;
}

int NAME_dynamics(const double *q, const double *v, double *M, double *h) {
  double Z[NV * LEADS], B[SPACE * SPACE], x[SPACE], moving[NV] = {0.0}, a[NV] = {0.0}, load[NV];
  double all[LEADS * (LEADS + 1)] = {0.0}, F[LEADS * LEADS], y[LEADS];
  int order[SPACE], exchanged[LEADS], i, k, l;
  Poses at;
  if (basis(q, &at, Z, B, order)) return 2;
  for (i = 0; i < NV; ++i)
    for (k = 0; k < MOTORS; ++k) moving[i] += Z[i * LEADS + k] * v[k];
  drift(&at, q, moving, x);
  solve(B, order, ROWS, x);
  for (i = 0; i < ROWS; ++i) a[follow[i]] = x[i];
  inverse_dynamics(&at, moving, a, load);
  subtract_applied(&at, q, moving, load);
  for (k = LEADS; k >= 0; --k) { /* the last column: forces; the others: inertia */
    for (i = 0; k < LEADS && i < NV; ++i) moving[i] = Z[i * LEADS + k];
    if (k < LEADS) momenta(&at, moving, load);
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
