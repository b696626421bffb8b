// The dynamics of a tree of bodies at several states at once, and the linear algebra of the stages of a step.
//
// A pack holds a number for each of `width` states, as the processor's vectors do. lanes.cpp is compiled once for each
// instruction set; plain numbers and pointers alone cross the border, since inline functions that two of these objects share
// would be merged by the linker. Arrays are [pack][item][lane].
//
// The recursions are in world axes, about a point that does not move. With twists S = (l, w) of unit velocities, body
// velocities V = (u, ω) and accelerations A (less gravity), a velocity k of the joint that moves body i, with parent λ, has
//
//     ψ_k = V_λ × S_k,    ψ'_k = A_λ × S_k + V_λ × ψ_k,    χ_k = (V_i + V_λ) × S_k.
//
// Composite bodies have mass m, first moment p and inertia I, momentum h = m u + ω × p, and
// N = -[ω] (½ tr(I) 1 - I) + (p·u) 1 - u pᵀ; these sums over the outer bodies contain all derivatives of forces by
// velocities, as B X = 2 (a × h, N a) depends on the angular part a of X alone. With μ_k = I S_k, β_k = 2 (Nᵀ w_k - l_k × h),
// and the force F of the outer bodies, for a velocity j of the same joint or further in,
//
//     M_kj = S_j·μ_k,    D_kj = β_k·w_j + μ_k·χ_j,    K_kj = β_k·ψ_j + μ_k·ψ'_j (angular part with β),
//     D_jk = S_j·(B S_k + I χ_k),    K_jk = S_j·(B ψ_k + I ψ'_k + S_k ×* F).
//
// References
// ----------
// J. Carpentier, N. Mansard, Analytical Derivatives of Rigid Body Dynamics Algorithms (2018): what Pinocchio computes.
#pragma once

namespace pinconsist {
namespace lanes {

enum Kind { REVOLUTE, UNBOUNDED, PRISMATIC, HELICAL, FREE_FLYER, PLANAR, SPHERICAL, TRANSLATION };

// A joint and the body that it carries, in axes in which that of a joint with one is z.
struct Body {
  Kind kind;
  int parent, q, v, nv; // parent -1 is the ground
  bool turned;          // whether `rotation` is not the identity
  double rotation[9], place[3]; // in the parent's axes, row by row
  double pitch;
  double mass, centre[3], inertia[6]; // about the centre: xx, xy, yy, xz, yz, zz
};

// Rows between a point of body 1 and a point of body 2: the components of their distance along axes of body 1, or
// (|d|² − L²) / (2 L).
struct PointRows {
  int at, n;           // first row, and their number
  double length;       // 0 for components
  int body1, body2;    // -1 is the ground
  double place1[3], place2[3], axes[9]; // axes: one a row
  const int *columns;  // velocities that move one of the bodies
  const double *signs; // 1 if it is body 2
  int moving;          // their number
};

// A spring and damper between two points: tension k (l - l₀) + d dl/dt.
struct Spring {
  int body1, body2; // -1 is the ground
  double place1[3], place2[3];
  double stiffness, length, damping, shortest;
  const int *columns, *joints; // velocities that move one of the bodies, and the joints they belong to
  const double *signs;
  int moving;
};

struct Tree {
  int bodies, nv, nq, nc, floating; // floating: a body with free translation, whose place is the origin; or -1
  const Body *body;
  const int *before; // of a velocity: the next one further in, or -1
  const double *armature, *damping, *constant;
  double gravity[3];
  const PointRows *rows;
  int kinds_of_rows;
  const Spring *springs;
  int number_of_springs;
};

// Arrays of a number of packs.
struct Fields {
  int packs;
  double *q, *v, *a;                  // nq, nv, nv
  double *f, *phi, *J, *M, *D, *K;    // nv, nc, nc × nv, nv × nv, row by row; zero before the first call
  double *twists, *poses;             // 6 for each velocity (linear part about `origin`), 12 for each body
  double origin[3];
  double *work;
  bool filled; // D and K have entries that are not those of a tree
};

// J dP = -Φ of all states, with the same dependent velocities: dP_dependent = G dP_free + closing.
struct Reduction {
  int nv, nc;
  int *order;           // dependent velocities, then free ones
  int *rows;            // the row of each dependent one
  unsigned char *filled; // nc × (nv + 1): entries of the reduced rows that may differ from zero
  double *E;            // nc × (nv + 1)
  bool chosen;
};

// The effect of dP on dV and dW of a joint in a chart, see stage_matrix.hpp: of stages i by each stage j, [pack][j][item][i], size
// × size column by column, for dP without the divisions by h.
struct Chart {
  int first, size;
  const double *dV, *dW;
};

// A step with s stages; b and b2 are s × s, column by column, see radau.hpp.
struct Step {
  int s;
  double h;
  const double *b, *b2;
  const Chart *chart;
  int charts; // their number
};

// One instruction set.
struct Kernel {
  const char *name;
  int width;
  long (*work)(const Tree &); // numbers that `evaluate` needs
  // f, Φ, J of states, and with derivatives M, D, K.
  void (*evaluate)(const Tree &tree, Fields &fields, bool derivatives);
  // Reduces the rows of `fields`; with `choose`, other dependent velocities may be chosen than last time. False if there
  // are none that suit all states.
  bool (*reduce)(const Fields &fields, Reduction &by, bool choose);
  // matrix = Newton's for s (nv - nc) unknowns, stage after stage for each free velocity.
  void (*assemble)(const Fields &fields, const Reduction &by, const Step &step, double *matrix);
  // Right-hand side of the unknowns; dP and the part of it that closes the rows (nv × s, column by column).
  void (*right_side)(const Fields &fields, const Reduction &by, const Step &step, double *y);
  void (*increments)(const Fields &fields, const Reduction &by, int s, const double *y, double *dP,
                     double *closing);
  // K -= F₀ + c (F₁ - F₀), with a c for each state: the derivatives of constraint forces.
  void (*bend)(Fields &fields, int nv, int s, const double *c, const double *F0, const double *F1);
  // LU with row pivots, of a matrix column by column; false if it is singular.
  bool (*factorise)(double *matrix, int n, int *pivots, double *inverses);
  void (*substitute)(const double *matrix, int n, const int *pivots, const double *inverses, double *x, int columns);
  // out = scale x weightsᵀ: x has n rows, weights are rows × columns; all column by column.
  void (*combine)(const double *x, int n, int columns, const double *weights, int rows, double scale, double *out);
  // C = A B with n × k and k × m numbers, column by column, those of B and C so many numbers from one another.
  void (*product)(const double *A, int n, int k, const double *B, int of_B, int m, double *C, int of_C);
  // Rates of ξ in charts, see charts.hpp, from those of the bodies, with the series x/2 coth(x/2): nv numbers for each state.
  void (*chart_rates)(const Tree &tree, int states, const double *xi, const double *rates, const double *series, int terms, double *out);
};

// The one in use: the best, unless `use` has chosen another.
const Kernel &kernel();
void use(const char *name); // empty: the best
int names(const char **list); // of those that this processor has, the plainest first; returns their number
constexpr int MOST_KERNELS = 3, LARGEST_TREE = 256 /* velocities */, MOST_STATES = 16;

} // namespace lanes
} // namespace pinconsist
