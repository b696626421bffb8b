// Compiled once for each instruction set, with LANES and WIDTH: no inline function may be shared with other files.
#include "lanes.hpp"

#include <initializer_list>
#include <math.h>
#include <string.h>

namespace pinconsist {
namespace lanes {
namespace {

constexpr int W = WIDTH;
typedef double Pack __attribute__((vector_size(8 * W), may_alias));
typedef long long Bits __attribute__((vector_size(8 * W), may_alias));

inline Pack all(double x) { return x - Pack{}; }
inline Pack load(const double *from) {
  Pack x;
  memcpy(&x, from, sizeof x);
  return x;
}
inline Pack absolute(Pack x) { return (Pack)((Bits)x & (Bits{} + 0x7fffffffffffffffLL)); }
inline Pack least(Pack a, Pack b) {
  const Bits less = a < b;
  return (Pack)(((Bits)a & less) | ((Bits)b & ~less));
}
inline Pack most(Pack a, Pack b) {
  const Bits more = a > b;
  return (Pack)(((Bits)a & more) | ((Bits)b & ~more));
}
inline double smallest(Pack x) {
  double found[W];
  memcpy(found, &x, sizeof x);
  for (int n = W / 2; n > 0; n /= 2)
    for (int i = 0; i < n; ++i) found[i] = found[i] < found[i + n] ? found[i] : found[i + n];
  return found[0];
}
inline double largest(Pack x) { return -smallest(-x); }

// Within one rounding of libm: reduction and polynomials of fdlibm.
inline void sine_and_cosine(Pack x, Pack &sine, Pack &cosine) {
  if (!(largest(absolute(x)) < 5e5)) {
    for (int i = 0; i < W; ++i) {
      sine[i] = sin(x[i]);
      cosine[i] = cos(x[i]);
    }
    return;
  }
  const double shift = 6755399441055744.0; // 1.5 2^52: the sum has the nearest integer in its last bits
  const Pack shifted = x * 6.36619772367581382433e-01 + shift, n = shifted - shift;
  const Bits quarter = (Bits)shifted;
  Pack r = x - n * 1.57079632673412561417e+00;
  Pack before = r, part = n * 6.07710050630396597660e-11;
  r = before - part;
  part = n * 2.02226624879595063154e-21 - ((before - r) - part);
  r -= part;
  const Pack z = r * r;
  const Pack s =
      r + r * z * (-1.66666666666666324348e-01 +
                   z * (8.33333333332248946124e-03 +
                        z * (-1.98412698298579493134e-04 +
                             z * (2.75573137070700676789e-06 + z * (-2.50507602534068634195e-08 + z * 1.58969099521155010221e-10)))));
  const Pack half = 0.5 * z, one = 1.0 - half;
  const Pack c = one + (((1.0 - one) - half) +
                        z * z * (4.16666666666666019037e-02 +
                                 z * (-1.38888888888741095749e-03 +
                                      z * (2.48015872894767294178e-05 +
                                           z * (-2.75573143513906633035e-07 +
                                                z * (2.08757232129817482790e-09 + z * -1.13596475577881948265e-11))))));
  const Bits swapped = -(quarter & 1);
  const Bits sine_sign = (quarter & 2) << 62, cosine_sign = ((quarter + 1) & 2) << 62;
  sine = (Pack)((((Bits)c & swapped) | ((Bits)s & ~swapped)) ^ sine_sign);
  cosine = (Pack)((((Bits)s & swapped) | ((Bits)c & ~swapped)) ^ cosine_sign);
}

struct Three {
  Pack x, y, z;
};
inline Three operator+(const Three &a, const Three &b) { return {a.x + b.x, a.y + b.y, a.z + b.z}; }
inline Three operator-(const Three &a, const Three &b) { return {a.x - b.x, a.y - b.y, a.z - b.z}; }
inline Three operator*(Pack k, const Three &a) { return {k * a.x, k * a.y, k * a.z}; }
inline Three operator*(double k, const Three &a) { return {k * a.x, k * a.y, k * a.z}; }
inline void operator+=(Three &a, const Three &b) { a = a + b; }
inline Pack dot(const Three &a, const Three &b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
inline Three cross(const Three &a, const Three &b) {
  return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}
inline Three three(const double *numbers) { return {all(numbers[0]), all(numbers[1]), all(numbers[2])}; }

// A rotation by its columns.
struct Axes {
  Three x, y, z;
};
inline Three turn(const Axes &R, const Three &a) {
  return {R.x.x * a.x + R.y.x * a.y + R.z.x * a.z, R.x.y * a.x + R.y.y * a.y + R.z.y * a.z, R.x.z * a.x + R.y.z * a.y + R.z.z * a.z};
}
inline Three turn(const Axes &R, const double *a) { return all(a[0]) * R.x + all(a[1]) * R.y + all(a[2]) * R.z; }
inline Three back(const Axes &R, const Three &a) { return {dot(R.x, a), dot(R.y, a), dot(R.z, a)}; }
inline Axes turn(const Axes &R, const Axes &other) { return {turn(R, other.x), turn(R, other.y), turn(R, other.z)}; }
inline Axes turn_by_rows(const Axes &R, const double *n) {
  return {all(n[0]) * R.x + all(n[3]) * R.y + all(n[6]) * R.z, all(n[1]) * R.x + all(n[4]) * R.y + all(n[7]) * R.z,
          all(n[2]) * R.x + all(n[5]) * R.y + all(n[8]) * R.z};
}
inline Axes about_z(const Axes &R, Pack cosine, Pack sine) { return {cosine * R.x + sine * R.y, cosine * R.y - sine * R.x, R.z}; }
inline Axes of_quaternion(const Pack *q) {
  const Pack x = q[0], y = q[1], z = q[2], w = q[3];
  return {{1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y)},
          {2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x)},
          {2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)}};
}

struct Symmetric {
  Pack xx, xy, yy, xz, yz, zz;
};
inline Three operator*(const Symmetric &I, const Three &a) {
  return {I.xx * a.x + I.xy * a.y + I.xz * a.z, I.xy * a.x + I.yy * a.y + I.yz * a.z, I.xz * a.x + I.yz * a.y + I.zz * a.z};
}

struct Twist {
  Three l, w;
};
inline Pack dot(const Twist &a, const Twist &b) { return dot(a.l, b.l) + dot(a.w, b.w); }
inline Twist operator+(const Twist &a, const Twist &b) { return {a.l + b.l, a.w + b.w}; }
inline void operator+=(Twist &a, const Twist &b) { a = a + b; }
inline Twist operator*(Pack k, const Twist &a) { return {k * a.l, k * a.w}; }
inline Twist cross(const Twist &a, const Twist &b) { return {cross(a.w, b.l) + cross(a.l, b.w), cross(a.w, b.w)}; }

struct Moving {
  Axes R;
  Three x;
  Twist v, a, force;
};
struct Composite {
  Three p, h;
  Symmetric I;
  Axes N;
  Pack m;
};
struct Column {
  Twist S, psi, psi2, chi;
};

struct Room {
  Moving *moving;
  Composite *composite;
  Column *column;
};
inline Room room(const Tree &tree, double *work) {
  Room all;
  all.moving = reinterpret_cast<Moving *>(work);
  all.composite = reinterpret_cast<Composite *>(all.moving + tree.bodies);
  all.column = reinterpret_cast<Column *>(all.composite + tree.bodies);
  return all;
}
long work(const Tree &tree) {
  return (tree.bodies * (sizeof(Moving) + sizeof(Composite)) + tree.nv * sizeof(Column)) / sizeof(double);
}

// The pose of a body, from that of its parent, and the twists of its joint.
inline void place(const Body &body, const Pack *q, const Axes &R0, const Three &x0, Moving &to, Column *columns) {
  Axes R = body.turned ? turn_by_rows(R0, body.rotation) : R0;
  Three x = x0 + turn(R0, body.place);
  Pack sine, cosine;
  switch (body.kind) {
  case REVOLUTE:
  case UNBOUNDED:
  case HELICAL:
    if (body.kind == UNBOUNDED) cosine = q[0], sine = q[1];
    else sine_and_cosine(q[0], sine, cosine);
    if (body.kind == HELICAL) x += (all(body.pitch) * q[0]) * R.z;
    R = about_z(R, cosine, sine);
    columns[0].S = Twist{cross(x, R.z), R.z};
    if (body.kind == HELICAL) columns[0].S.l += all(body.pitch) * R.z;
    break;
  case PRISMATIC:
    x += q[0] * R.z;
    columns[0].S = Twist{R.z, Three{}};
    break;
  case PLANAR:
    x += q[0] * R.x + q[1] * R.y;
    R = about_z(R, q[2], q[3]);
    columns[0].S = Twist{R.x, Three{}};
    columns[1].S = Twist{R.y, Three{}};
    columns[2].S = Twist{cross(x, R.z), R.z};
    break;
  case TRANSLATION:
    x += q[0] * R.x + q[1] * R.y + q[2] * R.z;
    columns[0].S = Twist{R.x, Three{}};
    columns[1].S = Twist{R.y, Three{}};
    columns[2].S = Twist{R.z, Three{}};
    break;
  case FREE_FLYER:
    x += q[0] * R.x + q[1] * R.y + q[2] * R.z;
    R = turn(R, of_quaternion(q + 3));
    columns[0].S = Twist{R.x, Three{}};
    columns[1].S = Twist{R.y, Three{}};
    columns[2].S = Twist{R.z, Three{}};
    columns += 3;
    columns[0].S = Twist{cross(x, R.x), R.x};
    columns[1].S = Twist{cross(x, R.y), R.y};
    columns[2].S = Twist{cross(x, R.z), R.z};
    break;
  case SPHERICAL:
    R = turn(R, of_quaternion(q));
    columns[0].S = Twist{cross(x, R.x), R.x};
    columns[1].S = Twist{cross(x, R.y), R.y};
    columns[2].S = Twist{cross(x, R.z), R.z};
    break;
  }
  to.R = R;
  to.x = x;
}

// Poses, velocities, accelerations and forces of the bodies.
template <bool derivatives> void move(const Tree &tree, const Room &at, const Pack *q, const Pack *v, const Pack *a, const Three &origin) {
  const Axes upright{{all(1.0), {}, {}}, {{}, all(1.0), {}}, {{}, {}, all(1.0)}};
  const Three gravity = three(tree.gravity), none{}, ground = none - origin;
  for (int i = 0; i < tree.bodies; ++i) {
    const Body &body = tree.body[i];
    const bool root = body.parent < 0;
    const Moving *parent = root ? nullptr : at.moving + body.parent;
    Moving &to = at.moving[i];
    Column *columns = at.column + body.v;
    place(body, q + body.q, root ? upright : parent->R, root ? ground : parent->x, to, columns);
    Twist own{}, faster{};
    for (int k = 0; k < body.nv; ++k) {
      own += v[body.v + k] * columns[k].S;
      faster += a[body.v + k] * columns[k].S;
    }
    if (root) {
      to.v = own;
      to.a = faster;
      to.a.l = to.a.l - gravity;
    } else {
      to.v = parent->v + own;
      to.a = parent->a + faster + cross(parent->v, own);
    }
    const Three c = to.x + turn(to.R, body.centre), &w = to.v.w;
    const Pack m = all(body.mass);
    const Three velocity = to.v.l + cross(w, c);
    const Three force = m * (to.a.l + cross(to.a.w, c) + cross(w, velocity));
    const double *n = body.inertia;
    Three moment;
    if (derivatives) {
      Composite &composite = at.composite[i];
      const Three X = all(n[0]) * to.R.x + all(n[1]) * to.R.y + all(n[3]) * to.R.z;
      const Three Y = all(n[1]) * to.R.x + all(n[2]) * to.R.y + all(n[4]) * to.R.z;
      const Three Z = all(n[3]) * to.R.x + all(n[4]) * to.R.y + all(n[5]) * to.R.z;
      Symmetric I;
      I.xx = to.R.x.x * X.x + to.R.y.x * Y.x + to.R.z.x * Z.x;
      I.xy = to.R.x.x * X.y + to.R.y.x * Y.y + to.R.z.x * Z.y;
      I.yy = to.R.x.y * X.y + to.R.y.y * Y.y + to.R.z.y * Z.y;
      I.xz = to.R.x.x * X.z + to.R.y.x * Y.z + to.R.z.x * Z.z;
      I.yz = to.R.x.y * X.z + to.R.y.y * Y.z + to.R.z.y * Z.z;
      I.zz = to.R.x.z * X.z + to.R.y.z * Y.z + to.R.z.z * Z.z;
      moment = I * to.a.w + cross(w, I * w);
      const Three p = m * c;
      I.xx += p.y * c.y + p.z * c.z;
      I.yy += p.x * c.x + p.z * c.z;
      I.zz += p.x * c.x + p.y * c.y;
      I.xy -= p.x * c.y;
      I.xz -= p.x * c.z;
      I.yz -= p.y * c.z;
      composite.m = m;
      composite.p = p;
      composite.h = m * velocity;
      composite.I = I;
      const Pack half = 0.5 * (I.xx + I.yy + I.zz), pu = dot(p, to.v.l);
      const Three &u = to.v.l;
      composite.N.x = cross(Three{half - I.xx, -I.xy, -I.xz}, w) - p.x * u;
      composite.N.y = cross(Three{-I.xy, half - I.yy, -I.yz}, w) - p.y * u;
      composite.N.z = cross(Three{-I.xz, -I.yz, half - I.zz}, w) - p.z * u;
      composite.N.x.x += pu;
      composite.N.y.y += pu;
      composite.N.z.z += pu;
      for (int k = 0; k < body.nv; ++k) {
        Column &column = columns[k];
        column.chi = cross(to.v, column.S);
        if (root) {
          column.psi = Twist{};
          column.psi2 = Twist{cross(none - gravity, column.S.w), Three{}};
        } else {
          column.psi = cross(parent->v, column.S);
          column.psi2 = cross(parent->a, column.S) + cross(parent->v, column.psi);
          column.chi += column.psi;
        }
      }
    } else {
      const Symmetric I{all(n[0]), all(n[1]), all(n[2]), all(n[3]), all(n[4]), all(n[5])};
      const Three rate = back(to.R, to.a.w), spin = back(to.R, w);
      moment = turn(to.R, I * rate + cross(spin, I * spin));
    }
    to.force = Twist{force, cross(c, force) + moment};
  }
}

inline Pack dot_force(const Twist &S, const Twist &force) { return dot(S.l, force.l) + dot(S.w, force.w); }

void gather_forces(const Tree &tree, const Room &at, const Pack *v, const Pack *a, Pack *f) {
  for (int i = tree.bodies; i-- > 0;) {
    const Body &body = tree.body[i];
    const Twist &force = at.moving[i].force;
    for (int k = body.v; k < body.v + body.nv; ++k)
      f[k] = dot_force(at.column[k].S, force) + tree.armature[k] * a[k] + tree.damping[k] * v[k] - tree.constant[k];
    if (body.parent >= 0) at.moving[body.parent].force += force;
  }
}

// After the forces have been gathered: `force` of each body is that of all outer ones.
void differentiate(const Tree &tree, const Room &at, Pack *M, Pack *D, Pack *K) {
  const int nv = tree.nv;
  for (int i = tree.bodies; i-- > 0;) {
    const Body &body = tree.body[i];
    const Composite &Y = at.composite[i];
    const Twist &force = at.moving[i].force;
    const int inner = tree.before[body.v];
    for (int k = body.v; k < body.v + body.nv; ++k) {
      const Column &of = at.column[k];
      const auto weighed = [&](const Twist &X) { return Twist{Y.m * X.l + cross(X.w, Y.p), Y.I * X.w + cross(Y.p, X.l)}; };
      const auto turning = [&](const Three &a) { return Twist{2.0 * cross(a, Y.h), 2.0 * turn(Y.N, a)}; };
      const Twist mu = weighed(of.S);
      const Three beta = 2.0 * (back(Y.N, of.S.w) - cross(of.S.l, Y.h));
      const auto row = [&](int j) {
        const Column &other = at.column[j];
        M[j * nv + k] = M[k * nv + j] = dot(other.S, mu);
        D[k * nv + j] = dot(beta, other.S.w) + dot(mu, other.chi);
        K[k * nv + j] = dot(beta, other.psi.w) + dot(mu, other.psi2);
      };
      for (int j = body.v; j < body.v + body.nv; ++j) row(j);
      M[k * nv + k] += tree.armature[k];
      D[k * nv + k] += tree.damping[k];
      if (inner < 0) continue;
      const Twist by_v = turning(of.S.w) + weighed(of.chi);
      Twist by_q = turning(of.psi.w) + weighed(of.psi2);
      by_q.l += cross(of.S.w, force.l);
      by_q.w += cross(of.S.l, force.l) + cross(of.S.w, force.w);
      for (int j = inner; j >= 0; j = tree.before[j]) {
        row(j);
        const Twist &S = at.column[j].S;
        D[j * nv + k] = dot(S, by_v);
        K[j * nv + k] = dot(S, by_q);
      }
    }
    if (body.parent < 0) continue;
    Composite &outer = at.composite[body.parent];
    outer.m += Y.m;
    outer.p += Y.p;
    outer.h += Y.h;
    outer.I = {outer.I.xx + Y.I.xx, outer.I.xy + Y.I.xy, outer.I.yy + Y.I.yy, outer.I.xz + Y.I.xz, outer.I.yz + Y.I.yz, outer.I.zz + Y.I.zz};
    outer.N.x += Y.N.x;
    outer.N.y += Y.N.y;
    outer.N.z += Y.N.z;
  }
}

inline Three point(const Room &at, const Three &origin, int body, const double *place) {
  return body < 0 ? three(place) - origin : at.moving[body].x + turn(at.moving[body].R, place);
}

// Adds a spring's forces to f, and with derivatives to D and K, see SpringDamper in forces.hpp.
template <bool derivatives>
void add_spring(const Tree &tree, const Spring &spring, const Room &at, const Three &origin, const Pack *v, Pack *f, Pack *D, Pack *K) {
  const int n = spring.moving;
  const Three x1 = point(at, origin, spring.body1, spring.place1), x2 = point(at, origin, spring.body2, spring.place2), r = x2 - x1;
  Pack l = dot(r, r) + spring.shortest * spring.shortest;
  for (int i = 0; i < W; ++i) l[i] = sqrt(l[i]);
  const Three u = (1.0 / l) * r;
  Three moves[LARGEST_TREE];
  Pack along[LARGEST_TREE], rate{};
  for (int i = 0; i < n; ++i) {
    const Twist &S = at.column[spring.columns[i]].S;
    moves[i] = spring.signs[i] * (S.l + cross(S.w, spring.signs[i] > 0.0 ? x2 : x1));
    along[i] = dot(u, moves[i]);
    rate += along[i] * v[spring.columns[i]];
  }
  const Pack tension = spring.stiffness * (l - spring.length) + spring.damping * rate;
  for (int i = 0; i < n; ++i) f[spring.columns[i]] += tension * along[i];
  if (!derivatives) return;
  for (int j = 0; j < n; ++j) {
    Pack bend[LARGEST_TREE], turning{};
    for (int i = 0; i < n; ++i) {
      bend[i] = (dot(moves[i], moves[j]) - along[i] * along[j]) / l;
      if (spring.signs[i] == spring.signs[j]) {
        const int before = spring.joints[j] <= spring.joints[i] ? j : i, after = before == j ? i : j;
        bend[i] += dot(u, cross(at.column[spring.columns[before]].S.w, moves[after]));
      }
      turning += v[spring.columns[i]] * bend[i];
    }
    for (int i = 0; i < n; ++i) {
      const long entry = static_cast<long>(spring.columns[i]) * tree.nv + spring.columns[j];
      D[entry] += spring.damping * (along[i] * along[j]);
      K[entry] += spring.stiffness * (along[i] * along[j]) + tension * bend[i] + spring.damping * (along[i] * turning);
    }
  }
}

// Φ and J of rows between points, added to zeros.
void fill(const Tree &tree, const Room &at, const Three &origin, Pack *phi, Pack *J) {
  const int nv = tree.nv;
  for (int number = 0; number < tree.kinds_of_rows; ++number) {
    const PointRows &rows = tree.rows[number];
    const Three x2 = point(at, origin, rows.body2, rows.place2), gap = x2 - point(at, origin, rows.body1, rows.place1);
    for (int i = 0; i < rows.n; ++i) {
      Pack *row = J + (rows.at + i) * nv;
      Three along;
      if (rows.length) {
        phi[rows.at + i] += (dot(gap, gap) - rows.length * rows.length) / (2.0 * rows.length);
        along = all(1.0 / rows.length) * gap;
      } else {
        along = rows.body1 < 0 ? three(rows.axes + 3 * i) : turn(at.moving[rows.body1].R, rows.axes + 3 * i);
        phi[rows.at + i] += dot(along, gap);
      }
      const Twist wrench{along, cross(x2, along)};
      for (int c = 0; c < rows.moving; ++c)
        row[rows.columns[c]] += rows.signs[c] * dot_force(at.column[rows.columns[c]].S, wrench);
    }
  }
}

void show(const Tree &tree, const Room &at, Pack *twists, Pack *poses) {
  for (int k = 0; k < tree.nv; ++k) memcpy(twists + 6 * k, &at.column[k].S, sizeof(Twist));
  for (int i = 0; i < tree.bodies; ++i) {
    memcpy(poses + 12 * i, &at.moving[i].R, sizeof(Axes));
    memcpy(poses + 12 * i + 9, &at.moving[i].x, sizeof(Three));
  }
}

// Where the floating body is in the first state, so that distances from it are not differences of large numbers.
void find_origin(const Tree &tree, Fields &fields) {
  for (double &x : fields.origin) x = 0.0;
  if (tree.floating < 0) return;
  const Body &body = tree.body[tree.floating];
  double moved[3] = {};
  const int n = body.kind == PLANAR ? 2 : 3;
  for (int c = 0; c < n; ++c) moved[c] = fields.q[(body.q + c) * W];
  for (int r = 0; r < 3; ++r) {
    fields.origin[r] = body.place[r];
    for (int c = 0; c < 3; ++c) fields.origin[r] += body.rotation[3 * r + c] * moved[c];
  }
}

void evaluate(const Tree &tree, Fields &fields, bool derivatives) {
  const Room at = room(tree, fields.work);
  find_origin(tree, fields);
  const Three origin = three(fields.origin);
  const long nv = tree.nv, nc = tree.nc;
  if (derivatives && fields.filled)
    for (double *of : {fields.D, fields.K}) memset(of, 0, fields.packs * nv * nv * sizeof(Pack));
  if (derivatives) fields.filled = tree.number_of_springs > 0;
  for (int pack = 0; pack < fields.packs; ++pack) {
    const auto part = [&](double *of, long items) { return reinterpret_cast<Pack *>(of) + pack * items; };
    const Pack *v = part(fields.v, nv), *a = part(fields.a, nv);
    if (derivatives) move<true>(tree, at, part(fields.q, tree.nq), v, a, origin);
    else move<false>(tree, at, part(fields.q, tree.nq), v, a, origin);
    gather_forces(tree, at, v, a, part(fields.f, nv));
    if (derivatives) differentiate(tree, at, part(fields.M, nv * nv), part(fields.D, nv * nv), part(fields.K, nv * nv));
    for (int i = 0; i < tree.number_of_springs; ++i) {
      Pack *f = part(fields.f, nv);
      if (derivatives)
        add_spring<true>(tree, tree.springs[i], at, origin, v, f, part(fields.D, nv * nv), part(fields.K, nv * nv));
      else add_spring<false>(tree, tree.springs[i], at, origin, v, f, nullptr, nullptr);
    }
    Pack *phi = part(fields.phi, nc), *J = part(fields.J, nc * nv);
    memset(phi, 0, nc * sizeof(Pack));
    memset(J, 0, nc * nv * sizeof(Pack));
    fill(tree, at, origin, phi, J);
    show(tree, at, part(fields.twists, 6 * nv), part(fields.poses, 12 * tree.bodies));
  }
}

// The smallest size of an entry of the reduced rows among all states.
inline double certain(const Reduction &by, int packs, int row, int column) {
  const long items = by.nc * (by.nv + 1);
  const Pack *E = reinterpret_cast<const Pack *>(by.E) + row * (by.nv + 1) + column;
  Pack x = absolute(E[0]);
  for (int pack = 1; pack < packs; ++pack) x = least(x, absolute(E[pack * items]));
  return smallest(x);
}

inline void swap(int &a, int &b) {
  const int kept = a;
  a = b;
  b = kept;
}

// Which pivots are chosen anew: none, rows, or rows and columns.
enum Choice { NONE, ROWS, BOTH };

// The reduced row echelon form. Without a choice, pivots must not be much smaller than other entries of their column.
bool echelon(const Fields &fields, Reduction &by, Choice choose) {
  const int nv = by.nv, nc = by.nc, packs = fields.packs, n = nv + 1;
  const long items = static_cast<long>(nc) * n;
  Pack *E = reinterpret_cast<Pack *>(by.E);
  const Pack *J = reinterpret_cast<const Pack *>(fields.J), *phi = reinterpret_cast<const Pack *>(fields.phi);
  if (choose == BOTH)
    for (int j = 0; j < nv; ++j) by.order[j] = j;
  if (choose)
    for (int i = 0; i < nc; ++i) by.rows[i] = i;
  Pack sizes{};
  for (int pack = 0; pack < packs; ++pack)
    for (int i = 0; i < nc; ++i) {
      const Pack *row = J + pack * static_cast<long>(nc) * nv + static_cast<long>(by.rows[i]) * nv;
      Pack *to = E + pack * items + i * n;
      for (int j = 0; j < nv; ++j) {
        to[j] = row[by.order[j]];
        sizes = most(sizes, absolute(to[j]));
      }
      to[nv] = phi[pack * static_cast<long>(nc) + by.rows[i]];
    }
  const double little = 2.220446049250313e-16 * largest(sizes);
  if (choose) // which entries differ from zero somewhere
    for (int i = 0; i < nc; ++i)
      for (int j = 0; j < nv; ++j) {
        Pack size{};
        for (int pack = 0; pack < packs; ++pack) size = most(size, absolute(E[pack * items + i * n + j]));
        by.filled[i * n + j] = largest(size) != 0.0;
      }
  if (choose)
    for (int i = 0; i < nc; ++i) by.filled[i * n + nv] = 1;
  for (int k = 0; k < nc; ++k) {
    if (choose) {
      int row = k, column = k;
      double best = -1.0;
      for (int i = k; i < nc; ++i)
        for (int j = k; j < (choose == BOTH ? nv : k + 1); ++j) {
          if (!by.filled[i * n + j]) continue;
          const double size = certain(by, packs, i, j);
          if (size > best) best = size, row = i, column = j;
        }
      if (!(best > little)) return false;
      if (column != k) {
        swap(by.order[k], by.order[column]);
        for (int i = 0; i < nc; ++i) {
          for (int pack = 0; pack < packs; ++pack) {
            Pack *of = E + pack * items + i * n, kept = of[k];
            of[k] = of[column];
            of[column] = kept;
          }
          const unsigned char kept = by.filled[i * n + k];
          by.filled[i * n + k] = by.filled[i * n + column];
          by.filled[i * n + column] = kept;
        }
      }
      if (row != k) {
        swap(by.rows[k], by.rows[row]);
        for (int j = 0; j < n; ++j) {
          for (int pack = 0; pack < packs; ++pack) {
            Pack *of = E + pack * items, kept = of[k * n + j];
            of[k * n + j] = of[row * n + j];
            of[row * n + j] = kept;
          }
          const unsigned char kept = by.filled[k * n + j];
          by.filled[k * n + j] = by.filled[row * n + j];
          by.filled[row * n + j] = kept;
        }
      }
    } else {
      Pack shortest = all(1e300), others{};
      for (int pack = 0; pack < packs; ++pack) {
        const Pack *of = E + pack * items + k;
        const Pack pivot = absolute(of[k * n]);
        for (int i = k + 1; i < nc; ++i)
          if (by.filled[i * n + k]) others = most(others, absolute(of[i * n]) - 10.0 * pivot);
        shortest = least(shortest, pivot);
      }
      if (!(smallest(shortest) > little) || !(largest(others) <= 0.0)) return false;
    }
    int list[LARGEST_TREE + 1], listed = 0;
    for (int j = k + 1; j < n; ++j)
      if (by.filled[k * n + j]) list[listed++] = j;
    for (int pack = 0; pack < packs; ++pack) {
      Pack *of = E + pack * items, *pivot = of + k * n;
      const Pack inverse = 1.0 / pivot[k];
      for (int j = 0; j < listed; ++j) pivot[list[j]] *= inverse;
      for (int i = 0; i < nc; ++i) {
        if (i == k || !by.filled[i * n + k]) continue;
        Pack *other = of + i * n;
        const Pack factor = other[k];
        for (int j = 0; j < listed; ++j) other[list[j]] -= factor * pivot[list[j]];
      }
    }
    if (choose)
      for (int i = 0; i < nc; ++i)
        if (i != k && by.filled[i * n + k])
          for (int j = k + 1; j < n; ++j) by.filled[i * n + j] |= by.filled[k * n + j];
  }
  return true;
}

// The largest slope of the dependent velocities by the free ones.
double steepness(const Fields &fields, const Reduction &by) {
  const int nv = by.nv, nc = by.nc, n = nv + 1;
  Pack slope{};
  for (int pack = 0; pack < fields.packs; ++pack)
    for (int k = 0; k < nc; ++k) {
      const Pack *row = reinterpret_cast<const Pack *>(by.E) + (pack * static_cast<long>(nc) + k) * n;
      for (int j = nc; j < nv; ++j) slope = most(slope, absolute(row[j]));
    }
  return largest(slope);
}

constexpr int SIDE_BY_SIDE = 128; // unknowns
constexpr double STEEPEST = 10.0; // as in null_space.hpp

bool reduce(const Fields &fields, Reduction &by, bool choose) {
  const bool kept = by.chosen && (echelon(fields, by, NONE) || echelon(fields, by, ROWS));
  if (!choose || (kept && steepness(fields, by) <= STEEPEST)) return kept;
  return by.chosen = echelon(fields, by, BOTH);
}

// x_free + Gᵀ x_dependent, for the free velocity a.
struct Slopes {
  const Pack *E;
  const unsigned char *filled;
  int n, nc;
  bool has(int k, int a) const { return filled[k * n + nc + a]; }
  Pack at(int k, int a) const { return -E[k * n + nc + a]; }
};

// For each stage j, weights of dP_j in the velocities (b) or accelerations (b2) of the stages of a pack.
void weights(const double *b, int s, int first, int lanes, double scale, Pack *of) {
  for (int j = 0; j < s; ++j) {
    of[j] = Pack{};
    for (int lane = 0; lane < lanes; ++lane) of[j][lane] = scale * b[j * s + first + lane];
  }
}

void assemble(const Fields &fields, const Reduction &by, const Step &step, double *matrix) {
  const int nv = by.nv, nc = by.nc, nd = nv - nc, n = nv + 1, s = step.s, size = s * nd;
  const double h = step.h;
  const int *order = by.order;
  Pack rows[3 * LARGEST_TREE], mixed[LARGEST_TREE]; // of M, D, K times Z; columns in `order`
  Pack of_M[MOST_STATES], of_D[MOST_STATES];
  int place[LARGEST_TREE];
  for (int c = 0; c < nv; ++c) place[order[c]] = c;
  for (int pack = 0; pack < fields.packs; ++pack) {
    const int first = pack * W, lanes = s - first < W ? s - first : W;
    if (lanes <= 0) break;
    const Slopes G{reinterpret_cast<const Pack *>(by.E) + pack * static_cast<long>(nc) * n, by.filled, n, nc};
    const Pack *parts[3];
    for (int part = 0; part < 3; ++part) {
      const double *of = part == 0 ? fields.M : part == 1 ? fields.D : fields.K;
      parts[part] = reinterpret_cast<const Pack *>(of) + pack * static_cast<long>(nv) * nv;
    }
    weights(step.b2, s, first, lanes, 1.0, of_M);
    weights(step.b, s, first, lanes, h, of_D);
    for (int a = 0; a < nd; ++a) {
      for (int part = 0; part < 3; ++part) {
        Pack *row = rows + part * LARGEST_TREE;
        const Pack *free = parts[part] + static_cast<long>(order[nc + a]) * nv;
        for (int c = 0; c < nv; ++c) row[c] = free[order[c]];
        for (int k = 0; k < nc; ++k) {
          if (!G.has(k, a)) continue;
          const Pack slope = G.at(k, a);
          const Pack *of = parts[part] + static_cast<long>(order[k]) * nv;
          for (int c = 0; c < nv; ++c) row[c] += slope * of[order[c]];
        }
      }
      const Pack *M = rows, *D = rows + LARGEST_TREE, *K = D + LARGEST_TREE;
      for (int j = 0; j < s; ++j) {
        for (int c = 0; c < nv; ++c) mixed[c] = of_M[j] * M[c] + of_D[j] * D[c];
        for (int i = 0; i < step.charts; ++i) {
          const Chart &chart = step.chart[i];
          const int m = chart.size;
          const Pack *dV = reinterpret_cast<const Pack *>(chart.dV) + (pack * static_cast<long>(s) + j) * m * m;
          const Pack *dW = reinterpret_cast<const Pack *>(chart.dW) + (pack * static_cast<long>(s) + j) * m * m;
          for (int r = 0; r < m; ++r) {
            Pack sum{};
            for (int k = 0; k < m; ++k) {
              const int at = place[chart.first + k];
              sum += dW[r * m + k] * M[at] + h * (dV[r * m + k] * D[at]);
            }
            mixed[place[chart.first + r]] = sum;
          }
        }
        if (j >= first && j < first + lanes) {
          Pack own{};
          own[j - first] = h * h;
          for (int c = 0; c < nv; ++c) mixed[c] += own * K[c];
        }
        const double *Gj = by.E + ((j / W) * static_cast<long>(nc) * n) * W + j % W;
        for (int f = 0; f < nd; ++f) {
          Pack sum = mixed[nc + f];
          for (int k = 0; k < nc; ++k)
            if (G.has(k, f)) sum -= mixed[k] * Gj[(k * n + nc + f) * W];
          double *to = matrix + static_cast<long>(f * s + j) * size + a * s + first;
          if (lanes == W) memcpy(to, &sum, sizeof sum);
          else
            for (int lane = 0; lane < lanes; ++lane) to[lane] = sum[lane];
        }
      }
    }
  }
}

void right_side(const Fields &fields, const Reduction &by, const Step &step, double *y) {
  const int nv = by.nv, nc = by.nc, nd = nv - nc, n = nv + 1, s = step.s;
  const double h = step.h;
  const int *order = by.order;
  Pack left[LARGEST_TREE], dV[LARGEST_TREE], dW[LARGEST_TREE], shift[LARGEST_TREE]; // velocities in `order`
  Pack of_V[MOST_STATES], of_W[MOST_STATES];
  int place[LARGEST_TREE];
  for (int c = 0; c < nv; ++c) place[order[c]] = c;
  const auto closing = [&](int c, int j) { // of the velocity at place c, in stage j
    return c < nc ? -by.E[(((j / W) * static_cast<long>(nc) + c) * n + nv) * W + j % W] : 0.0;
  };
  for (int pack = 0; pack < fields.packs; ++pack) {
    const int first = pack * W, lanes = s - first < W ? s - first : W;
    if (lanes <= 0) break;
    const long begins = pack * static_cast<long>(nv);
    const Pack *own = reinterpret_cast<const Pack *>(by.E) + pack * static_cast<long>(nc) * n;
    const Slopes G{own, by.filled, n, nc};
    const Pack *f = reinterpret_cast<const Pack *>(fields.f) + begins;
    const Pack *M = reinterpret_cast<const Pack *>(fields.M) + begins * nv, *D = reinterpret_cast<const Pack *>(fields.D) + begins * nv,
               *K = reinterpret_cast<const Pack *>(fields.K) + begins * nv;
    weights(step.b, s, first, lanes, h, of_V);
    weights(step.b2, s, first, lanes, 1.0, of_W);
    for (int c = 0; c < nv; ++c) dV[c] = dW[c] = Pack{};
    for (int j = 0; j < s; ++j)
      for (int k = 0; k < nc; ++k) {
        const double moved = closing(k, j);
        dV[k] += of_V[j] * moved;
        dW[k] += of_W[j] * moved;
      }
    for (int i = 0; i < step.charts; ++i) {
      const Chart &chart = step.chart[i];
      const int m = chart.size;
      for (int r = 0; r < m; ++r) {
        Pack by_V{}, by_W{};
        for (int j = 0; j < s; ++j)
          for (int k = 0; k < m; ++k) {
            const long at = (pack * static_cast<long>(s) + j) * m * m + k * m + r;
            const double moved = closing(place[chart.first + k], j);
            by_V += reinterpret_cast<const Pack *>(chart.dV)[at] * moved;
            by_W += reinterpret_cast<const Pack *>(chart.dW)[at] * moved;
          }
        dV[place[chart.first + r]] = h * by_V;
        dW[place[chart.first + r]] = by_W;
      }
    }
    const int moved = step.charts ? nv : nc; // velocities that closing the rows moves
    for (int c = 0; c < nc; ++c) shift[c] = h * h * -own[c * n + nv];
    for (int r = 0; r < nv; ++r) {
      const long row = static_cast<long>(r) * nv;
      Pack sum = h * h * f[r];
      for (int c = 0; c < nc; ++c) sum += K[row + order[c]] * shift[c];
      for (int c = 0; c < moved; ++c) sum += M[row + order[c]] * dW[c] + D[row + order[c]] * dV[c];
      left[r] = -sum;
    }
    for (int a = 0; a < nd; ++a) {
      Pack sum = left[order[nc + a]];
      for (int k = 0; k < nc; ++k)
        if (G.has(k, a)) sum += G.at(k, a) * left[order[k]];
      for (int lane = 0; lane < lanes; ++lane) y[a * s + first + lane] = sum[lane];
    }
  }
}

void increments(const Fields &fields, const Reduction &by, int s, const double *y, double *dP, double *closing) {
  const int nv = by.nv, nc = by.nc, nd = nv - nc, n = nv + 1;
  for (int pack = 0; pack < fields.packs; ++pack) {
    const int first = pack * W, lanes = s - first < W ? s - first : W;
    if (lanes <= 0) break;
    const Pack *own = reinterpret_cast<const Pack *>(by.E) + pack * static_cast<long>(nc) * n;
    const Slopes G{own, by.filled, n, nc};
    Pack free[LARGEST_TREE];
    for (int a = 0; a < nd; ++a) {
      free[a] = Pack{};
      for (int lane = 0; lane < lanes; ++lane) {
        free[a][lane] = y[a * s + first + lane];
        dP[(first + lane) * nv + by.order[nc + a]] = free[a][lane];
        closing[(first + lane) * nv + by.order[nc + a]] = 0.0;
      }
    }
    for (int k = 0; k < nc; ++k) {
      Pack sum = -own[k * n + nv];
      for (int lane = 0; lane < lanes; ++lane) closing[(first + lane) * nv + by.order[k]] = sum[lane];
      for (int a = 0; a < nd; ++a)
        if (G.has(k, a)) sum += G.at(k, a) * free[a];
      for (int lane = 0; lane < lanes; ++lane) dP[(first + lane) * nv + by.order[k]] = sum[lane];
    }
  }
}

// T rate = (1 + ad/2 + Σ weights ad²ⁿ) rate for the joints in charts, ad the bracket with ξ: nv numbers for each state.
void chart_rates(const Tree &tree, int states, const double *xi, const double *rates, const double *series, int terms, double *out) {
  const int nv = tree.nv;
  memcpy(out, rates, sizeof(double) * nv * states);
  for (int i = 0; i < tree.bodies; ++i) {
    const Body &body = tree.body[i];
    if (body.kind != FREE_FLYER && body.kind != PLANAR && body.kind != SPHERICAL) continue;
    for (int first = 0; first < states; first += W) {
      const int lanes = states - first < W ? states - first : W;
      const auto get = [&](const double *from) {
        Pack n[6] = {};
        for (int lane = 0; lane < W; ++lane) {
          const double *of = from + static_cast<long>(first + (lane < lanes ? lane : lanes - 1)) * nv + body.v;
          for (int k = 0; k < body.nv; ++k) n[k][lane] = of[k];
        }
        if (body.kind == SPHERICAL) return Twist{Three{}, {n[0], n[1], n[2]}};
        if (body.kind == PLANAR) return Twist{{n[0], n[1], Pack{}}, {Pack{}, Pack{}, n[2]}};
        return Twist{{n[0], n[1], n[2]}, {n[3], n[4], n[5]}};
      };
      const auto size = [](const Twist &x) {
        return most(most(most(absolute(x.l.x), absolute(x.l.y)), most(absolute(x.l.z), absolute(x.w.x))), most(absolute(x.w.y), absolute(x.w.z)));
      };
      const Twist x = get(xi);
      Twist power = get(rates), sum = power;
      sum += all(0.5) * cross(x, power);
      for (int term = 0; term < terms; ++term) {
        power = cross(x, cross(x, power));
        sum += all(series[term]) * power;
        if (!(largest(fabs(series[term]) * size(power) - 2.220446049250313e-16 * size(sum)) > 0.0)) break;
      }
      const Pack n[] = {sum.l.x, sum.l.y, sum.l.z, sum.w.x, sum.w.y, sum.w.z};
      const int places[3][6] = {{0, 1, 2, 3, 4, 5}, {0, 1, 5}, {3, 4, 5}};
      const int *place = places[body.kind == FREE_FLYER ? 0 : body.kind == PLANAR ? 1 : 2];
      for (int lane = 0; lane < lanes; ++lane)
        for (int k = 0; k < body.nv; ++k) out[static_cast<long>(first + lane) * nv + body.v + k] = n[place[k]][lane];
    }
  }
}

// K -= F₀ + c (F₁ - F₀)
void bend(Fields &fields, int nv, int s, const double *c, const double *F0, const double *F1) {
  for (int pack = 0; pack < fields.packs; ++pack) {
    Pack part{};
    for (int lane = 0; lane < W && pack * W + lane < s; ++lane) part[lane] = c[pack * W + lane];
    Pack *K = reinterpret_cast<Pack *>(fields.K) + pack * static_cast<long>(nv) * nv;
    long F = 0;
    for (int column = 0; column < nv; ++column)
      for (int row = 0; row < nv; ++row, ++F) {
        if (F0[F] != 0.0 || F1[F] != 0.0) K[static_cast<long>(row) * nv + column] -= F0[F] + part * (F1[F] - F0[F]);
      }
  }
  fields.filled = true;
}

// x += factor y
inline void add_multiple(double factor, const double *y, double *x, int n) {
  int i = 0;
  for (; i + W <= n; i += W) {
    const Pack sum = load(x + i) + factor * load(y + i);
    memcpy(x + i, &sum, sizeof sum);
  }
  for (; i < n; ++i) x[i] += factor * y[i];
}

// Of the largest size; the first number if there is NaN.
inline int largest_of(const double *x, int n) {
  Pack sizes{};
  int i = 0;
  for (; i + W <= n; i += W) sizes = most(sizes, absolute(load(x + i)));
  double size = largest(sizes);
  for (; i < n; ++i) size = fabs(x[i]) > size ? fabs(x[i]) : size;
  for (i = 0; i < n; ++i)
    if (fabs(x[i]) == size) return i;
  return 0;
}

bool factorise(double *matrix, int n, int *pivots, double *inverses) {
  for (int k = 0; k < n; ++k) {
    double *column = matrix + static_cast<long>(k) * n;
    const int pivot = k + largest_of(column + k, n - k);
    pivots[k] = pivot + 1;
    if (column[pivot] == 0.0) return false;
    if (pivot != k)
      for (int j = 0; j < n; ++j) {
        double *of = matrix + static_cast<long>(j) * n;
        const double kept = of[k];
        of[k] = of[pivot];
        of[pivot] = kept;
      }
    const double inverse = inverses[k] = 1.0 / column[k];
    for (int i = k + 1; i < n; ++i) column[i] *= inverse;
    for (int j = k + 1; j < n; ++j) {
      double *other = matrix + static_cast<long>(j) * n;
      const double factor = other[k];
      if (factor != 0.0) add_multiple(-factor, column + k + 1, other + k + 1, n - k - 1);
    }
  }
  return true;
}

// Few right-hand sides side by side, the others one by one.
void substitute_one(const double *matrix, int n, const int *pivots, const double *inverses, double *x) {
  for (int k = 0; k < n; ++k) {
    const double kept = x[k];
    x[k] = x[pivots[k] - 1];
    x[pivots[k] - 1] = kept;
  }
  for (int k = 0; k < n; ++k)
    if (x[k] != 0.0) add_multiple(-x[k], matrix + static_cast<long>(k) * n + k + 1, x + k + 1, n - k - 1);
  for (int k = n; k-- > 0;) {
    x[k] *= inverses[k];
    add_multiple(-x[k], matrix + static_cast<long>(k) * n, x, k);
  }
}

void substitute_few(const double *matrix, int n, const int *pivots, const double *inverses, double *x, int columns) {
  Pack rows[SIDE_BY_SIDE];
  for (int k = 0; k < n; ++k)
    for (int c = 0; c < W; ++c) rows[k][c] = c < columns ? x[c * n + k] : 0.0;
  for (int k = 0; k < n; ++k) {
    const Pack kept = rows[k];
    rows[k] = rows[pivots[k] - 1];
    rows[pivots[k] - 1] = kept;
  }
  for (int k = 0; k < n; ++k) {
    const double *column = matrix + static_cast<long>(k) * n;
    for (int i = k + 1; i < n; ++i) rows[i] -= rows[k] * column[i];
  }
  for (int k = n; k-- > 0;) {
    const double *column = matrix + static_cast<long>(k) * n;
    rows[k] *= inverses[k];
    for (int i = 0; i < k; ++i) rows[i] -= rows[k] * column[i];
  }
  for (int k = 0; k < n; ++k)
    for (int c = 0; c < columns; ++c) x[c * n + k] = rows[k][c];
}

void substitute(const double *matrix, int n, const int *pivots, const double *inverses, double *x, int columns) {
  while (columns > 0) {
    const int few = columns < W ? columns : W;
    if (n <= SIDE_BY_SIDE && few > 1) substitute_few(matrix, n, pivots, inverses, x, few);
    else
      for (int c = 0; c < few; ++c) substitute_one(matrix, n, pivots, inverses, x + static_cast<long>(c) * n);
    columns -= few;
    x += static_cast<long>(few) * n;
  }
}

// Σ_j weights(i, j) x_j for each i, times a scale: columns of n numbers; weights row by row are `rows` × `columns`, column by column.
void combine(const double *x, int n, int columns, const double *weights, int rows, double scale, double *out) {
  int k = 0;
  for (; k + W <= n; k += W)
    for (int i = 0; i < rows; ++i) {
      Pack sum{};
      for (int j = 0; j < columns; ++j) sum += weights[j * rows + i] * load(x + static_cast<long>(j) * n + k);
      sum *= scale;
      memcpy(out + static_cast<long>(i) * n + k, &sum, sizeof sum);
    }
  if (k == n) return;
  for (int i = 0; i < rows; i += W) { // of the last few numbers, several columns at once
    const int lanes = rows - i < W ? rows - i : W;
    Pack of[MOST_STATES + 1];
    for (int j = 0; j < columns; ++j) {
      if (j * rows + i + W <= columns * rows) {
        of[j] = load(weights + j * rows + i);
      } else {
        of[j] = Pack{};
        for (int lane = 0; lane < lanes; ++lane) of[j][lane] = weights[j * rows + i + lane];
      }
    }
    for (int at = k; at < n; ++at) {
      Pack sum{};
      for (int j = 0; j < columns; ++j) sum += of[j] * x[static_cast<long>(j) * n + at];
      sum *= scale;
      for (int lane = 0; lane < lanes; ++lane) out[static_cast<long>(i + lane) * n + at] = sum[lane];
    }
  }
}

// F columns of C = A B; each sum has the same order with all instruction sets.
template <int F> void product_columns(const double *A, int n, int k, const double *B, int of_B, double *C, int of_C) {
  int i = 0;
  while (i + W <= n) {
    Pack sum[F] = {};
    for (int l = 0; l < k; ++l) {
      const Pack a = load(A + static_cast<long>(l) * n + i);
      for (int f = 0; f < F; ++f) sum[f] += a * B[static_cast<long>(f) * of_B + l];
    }
    for (int f = 0; f < F; ++f) memcpy(C + static_cast<long>(f) * of_C + i, sum + f, sizeof(Pack));
    i = i + W == n || i + 2 * W <= n ? i + W : n - W; // the last pack may overlap the one before
  }
  for (; i < n; ++i)
    for (int f = 0; f < F; ++f) {
      double sum = 0.0;
      for (int l = 0; l < k; ++l) sum += A[static_cast<long>(l) * n + i] * B[static_cast<long>(f) * of_B + l];
      C[static_cast<long>(f) * of_C + i] = sum;
    }
}

void product(const double *A, int n, int k, const double *B, int of_B, int m, double *C, int of_C) {
  int j = 0;
  for (; j + 8 <= m; j += 8) product_columns<8>(A, n, k, B + static_cast<long>(j) * of_B, of_B, C + static_cast<long>(j) * of_C, of_C);
  for (; j + 3 <= m; j += 3) product_columns<3>(A, n, k, B + static_cast<long>(j) * of_B, of_B, C + static_cast<long>(j) * of_C, of_C);
  for (; j < m; ++j) product_columns<1>(A, n, k, B + static_cast<long>(j) * of_B, of_B, C + static_cast<long>(j) * of_C, of_C);
}

} // namespace

extern const Kernel LANES;
const Kernel LANES = {NAME, W, work, evaluate, reduce, assemble, right_side, increments, bend, factorise, substitute, combine, product, chart_rates};

} // namespace lanes
} // namespace pinconsist
