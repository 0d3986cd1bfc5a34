/* Bicubic spline grounds in plain C: the polynomial of the cell at a point, and the point nearest to
 * a wheel, as CasADi calls external functions. `kernel.py` opens grounds and says what the numbers mean; `bicubic.py` does the same
 * without a compiler, and is what this is tested against. Functions of many points are opened by
 * `in_lanes` of core/lookups.py.
 *
 * Every ground that is open has a slot, whose function carries its number in its name: groundN,
 * from (x, y, key) to the middle of the cell and the 16 derivatives there, orders in x fastest; and
 * nearestN, which does what contact/touch.py says and does without a compiler.
 * CasADi counts its own uses of it (incref, decref); a slot in use is not given away. The key tells
 * grounds apart that have had the same slot: functions of another one, say from another process,
 * give no number instead of its heights.
 */
#include <math.h>
#include <stddef.h>
#include <string.h>

#ifdef _WIN32
#define API __declspec(dllexport)
#else
#define API __attribute__((visibility("default")))
#endif

#define SLOTS 64
#define LAYOUT 6 /* of the numbers below; kernel.py expects it */
#define ON_KNOT 1e-10 /* a point nearer to a knot than this, in cells, lies on it */

typedef long long int casadi_int;

typedef struct {
  const double *table;         /* coefficients, y fastest [m] */
  casadi_int width;            /* of a row of the table */
  double key, x, y;            /* x, y: local place of the node nearest to the local origin [m] */
  double h_x, h_y;             /* spacing [m] */
  double first_i, first_j;     /* that node's numbers */
  double last_i, last_j;       /* the last cell's */
  casadi_int uses;
} Ground;

static Ground grounds[SLOTS];

/* The four uniform cubic B-splines of a cell at u in [0, 1] and their derivatives, times six. */
static void basis(double u, int order, double b[4][4]) {
  double v = 1 - u;
  b[0][0] = v * v * v;
  b[0][3] = u * u * u;
  b[0][1] = 4 + 3 * (b[0][3] - 2 * (u * u));
  b[0][2] = 6 - b[0][0] - b[0][1] - b[0][3];
  if (order < 1) return;
  b[1][0] = -3 * v * v;
  b[1][1] = 3 * u * (3 * u - 4);
  b[1][2] = 3 * v * (4 - 3 * v);
  b[1][3] = 3 * u * u;
  b[2][0] = 6 * v;
  b[2][1] = 18 * u - 12;
  b[2][2] = 18 * v - 12;
  b[2][3] = 6 * u;
  b[3][0] = -6;
  b[3][1] = 18;
  b[3][2] = -18;
  b[3][3] = 6;
}

/* NaN is in the first cell, whose polynomial then returns NaN. A cast is faster than floor. */
static double cell(double a, double first, double last) {
  double below;
  a += ON_KNOT;
  if (!(a > -first)) return -first;
  if (a >= last - first) return last - first;
  below = (double)(casadi_int)a;
  return below > a ? below - 1 : below;
}

/* The first of the 16 coefficients of a cell, and its place in it. */
static const double *corner(const Ground *g, double x, double y, double *a, double *b, double *i,
                            double *j) {
  *a = (x - g->x) / g->h_x;
  *b = (y - g->y) / g->h_y;
  *i = cell(*a, g->first_i, g->last_i);
  *j = cell(*b, g->first_j, g->last_j);
  return g->table + (casadi_int)(*i + g->first_i) * g->width + (casadi_int)(*j + g->first_j);
}

static double height(const Ground *g, double x, double y) {
  double a, b, i, j, in_x[4][4], in_y[4][4], sum = 0;
  const double *c = corner(g, x, y, &a, &b, &i, &j);
  int m;
  basis(a - i, 0, in_x);
  basis(b - j, 0, in_y);
  for (m = 0; m < 4; m++, c += g->width)
    sum += in_x[0][m] * (in_y[0][0] * c[0] + in_y[0][1] * c[1] + in_y[0][2] * c[2] + in_y[0][3] * c[3]);
  return sum;
}

/* A key of another ground gives NaN, not an error: integrators and searches recover from it. */
static int refused(const Ground *g, const double **arg, int place, double *res, int count) {
  if (g->table && arg[0] && arg[0][place] == g->key) return 0;
  while (count--) res[count] = NAN;
  return 1;
}

static int polynomial(const Ground *g, const double **arg, double *res) {
  double a, b, i, j, middle[4][4], line[4], scale_x = 1, scale;
  const double *c;
  int m, n, k;
  if (!res || refused(g, arg, 2, res, 18)) return 0;
  c = corner(g, arg[0][0], arg[0][1], &a, &b, &i, &j);
  basis(0.5, 3, middle);
  res[0] = g->x + (i + 0.5) * g->h_x;
  res[1] = g->y + (j + 0.5) * g->h_y;
  for (m = 0; m < 4; m++) {
    for (k = 0; k < 4; k++)
      line[k] = middle[m][0] * c[k] + middle[m][1] * c[g->width + k] + middle[m][2] * c[2 * g->width + k]
              + middle[m][3] * c[3 * g->width + k];
    scale = scale_x;
    for (n = 0; n < 4; n++) {
      res[2 + m + 4 * n] = scale * (line[0] * middle[n][0] + line[1] * middle[n][1]
                                    + line[2] * middle[n][2] + line[3] * middle[n][3]);
      scale /= g->h_y;
    }
    scale_x /= g->h_x;
  }
  return 0;
}

/* Constants of the search for the nearest point; the same as in contact/touch.py. */
#define STEPS 2
#define DAMPED_STEPS 30
#define LONGEST_STEP 0.2
#define TOLERANCE 1e-9
#define CLEARLY_ABOVE 0.1
#define LARGE 1e9

/* Wheels with the section of a torus, in the order of the function's arguments. */
typedef struct {
  double center[3], axle[3], r1, r2, radius;
} Wheel;

/* Results in the order of the function's results, and the residual. Matrices are symmetric or by
 * columns. */
typedef struct {
  double spot[2], inverse[4], height, gradient[2], hessian[4], residual[2];
} Nearest;

static double dot(const double *a, const double *b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

/* Height, gradient and Hessian at the spot. */
static void jet(const Ground *g, Nearest *at) {
  double a, b, i, j, in_x[4][4], in_y[4][4], d[3][3] = {{0}};
  const double *c = corner(g, at->spot[0], at->spot[1], &a, &b, &i, &j);
  int m, n, k;
  basis(a - i, 3, in_x);
  basis(b - j, 3, in_y);
  for (m = 0; m < 4; m++, c += g->width)
    for (n = 0; n < 3; n++) {
      double line = in_y[n][0] * c[0] + in_y[n][1] * c[1] + in_y[n][2] * c[2] + in_y[n][3] * c[3];
      for (k = 0; k + n < 3; k++) d[k][n] += in_x[k][m] * line;
    }
  at->height = d[0][0];
  at->gradient[0] = d[1][0] / g->h_x;
  at->gradient[1] = d[0][1] / g->h_y;
  at->hessian[0] = d[2][0] / (g->h_x * g->h_x);
  at->hessian[1] = at->hessian[2] = d[1][1] / (g->h_x * g->h_y);
  at->hessian[3] = d[0][2] / (g->h_y * g->h_y);
}

/* The wheel's point with an outward normal, and the radial unit vector there; returns the radial
 * component of the normal. */
static double support(const Wheel *w, const double n[3], double point[3], double away[3]) {
  const double *a = w->axle, axial = dot(n, a);
  double cross[3] = {n[1] * a[2] - n[2] * a[1], n[2] * a[0] - n[0] * a[2], n[0] * a[1] - n[1] * a[0]};
  double radial = sqrt(dot(cross, cross));
  int i;
  for (i = 0; i < 3; i++) {
    away[i] = (n[i] - axial * a[i]) / radial;
    point[i] = w->center[i] + w->r1 * n[i] + w->r2 * away[i];
  }
  return radial;
}

/* Puts the spot under the wheel's lowest point and returns the vertical gap there. */
static double lowest(const Ground *g, const Wheel *w, double spot[2]) {
  /* cosines and sines of 0, -20, 20, -40, 40, -60 and 60 degrees */
  static const double directions[7][2] = {
    {1, 0},
    {0.9396926207859084, -0.3420201433256687}, {0.9396926207859084, 0.3420201433256687},
    {0.7660444431189780, -0.6427876096865393}, {0.7660444431189780, 0.6427876096865393},
    {0.5, -0.8660254037844386}, {0.5, 0.8660254037844386}};
  const double *a = w->axle, length = sqrt(a[0] * a[0] + a[1] * a[1] + TOLERANCE * TOLERANCE);
  double point[3], away[3], gap, least = 0;
  int k;
  for (k = 0; k < 7; k++) {
    double s = directions[k][1];
    double down[3] = {-s * a[1] / length, s * a[0] / length, -directions[k][0]};
    support(w, down, point, away);
    gap = point[2] - height(g, point[0], point[1]);
    if (k == 0 || gap < least) spot[0] = point[0], spot[1] = point[1];
    least = k ? fmin(gap, least) : gap;
  }
  return least;
}

/* All results at the spot; the step of Newton's method, if there is room for it. */
static void newton(const Ground *g, const Wheel *w, Nearest *at, double *step) {
  const double *grad = at->gradient, *hess = at->hessian, *f = at->residual;
  double n[3], point[3], away[3], radial, axial, norm, det, z, jac[2][2], *inv = at->inverse;
  int i, k;
  jet(g, at);
  norm = sqrt(1 + (grad[0] * grad[0] + grad[1] * grad[1]));
  n[0] = grad[0] / norm, n[1] = grad[1] / norm, n[2] = -1 / norm; /* out of the wheel */
  radial = support(w, n, point, away);
  axial = dot(n, w->axle);
  z = point[2] - at->height;
  for (i = 0; i < 2; i++) at->residual[i] = point[i] - at->spot[i] + z * grad[i];
  for (k = 0; k < 2; k++) { /* derivatives along x, y */
    const double *h = hess + 2 * k, turn = (grad[0] * h[0] + grad[1] * h[1]) / (norm * norm);
    double dn[3] = {h[0] / norm - n[0] * turn, h[1] / norm - n[1] * turn, -n[2] * turn}, dp[3];
    double bend = dot(dn, w->axle), shrink = axial * bend / radial; /* of -radial */
    for (i = 0; i < 3; i++)
      dp[i] = w->r1 * dn[i]
              + w->r2 * (dn[i] - bend * w->axle[i] + shrink * away[i]) / radial;
    for (i = 0; i < 2; i++) jac[i][k] = dp[i] - (i == k) + (dp[2] - grad[k]) * grad[i] + z * h[i];
  }
  det = jac[0][0] * jac[1][1] - jac[0][1] * jac[1][0];
  inv[0] = jac[1][1] / det, inv[1] = -jac[1][0] / det;
  inv[2] = -jac[0][1] / det, inv[3] = jac[0][0] / det;
  for (i = 0; i < 2 && step; i++) step[i] = -(inv[i] * f[0] + inv[i + 2] * f[1]);
}

static int converged(const Nearest *at) {
  return fabs(at->residual[0]) < TOLERANCE && fabs(at->residual[1]) < TOLERANCE;
}

static void newton_steps(const Ground *g, const Wheel *w, Nearest *at) {
  double step[2];
  int k;
  for (k = 0; k < STEPS; k++) {
    newton(g, w, at, step);
    at->spot[0] += step[0], at->spot[1] += step[1];
  }
  newton(g, w, at, NULL);
}

/* Steps of limited length, halved until they reduce the residual. */
static void damped(const Ground *g, const Wheel *w, Nearest *at) {
  double best[2] = {at->spot[0], at->spot[1]}, step[2] = {0, 0}, full[2], least = LARGE, size, part;
  int k, i;
  for (k = 0; k < DAMPED_STEPS; k++) {
    newton(g, w, at, full);
    size = at->residual[0] * at->residual[0] + at->residual[1] * at->residual[1];
    part = fmin(1, LONGEST_STEP * w->radius
                       / (sqrt(full[0] * full[0] + full[1] * full[1]) + TOLERANCE));
    for (i = 0; i < 2; i++) {
      if (size < least) best[i] = at->spot[i];
      step[i] = size < least ? part * full[i] : step[i] / 2;
      at->spot[i] = best[i] + step[i];
    }
    if (size < least) least = size;
  }
  at->spot[0] = best[0], at->spot[1] = best[1];
  newton(g, w, at, NULL);
}

static int nearest(const Ground *g, const double **arg, double *res) {
  const Wheel *w = (const Wheel *)arg[0];
  Nearest at;
  double place[2] = {0, 0}, above;
  int k;
  if (!res || refused(g, arg, 9, res, 13)) return 0;
  above = lowest(g, w, place);
  at.spot[0] = place[0], at.spot[1] = place[1];
  newton_steps(g, w, &at);
  if (!converged(&at)) newton_steps(g, w, &at);
  if (!converged(&at)) {
    at.spot[0] = place[0], at.spot[1] = place[1];
    damped(g, w, &at);
  }
  if (!converged(&at)) {
    at.spot[0] = place[0], at.spot[1] = place[1];
    jet(g, &at);
    for (k = 0; k < 4; k++) at.inverse[k] = 0;
    if (!(above > CLEARLY_ABOVE * w->radius))
      for (k = 0; k < 13; k++) ((double *)&at)[k] = NAN;
  }
  memcpy(res, &at, 13 * sizeof(double));
  return 0;
}

/* A function without calls at many points. Every operation is applied to WIDTH points at once, by
 * which the time to read it hardly counts. */
#define WIDTH 64

typedef struct {
  const int *code;            /* four numbers each: operation, target, two sources */
  casadi_int length, points;  /* of the code; of the function's matrices: one point in each row */
  const double *numbers;      /* constants, by operation */
  const casadi_int *shapes;   /* of arguments, of the key and of results, in CasADi's layout */
  casadi_int n_in, n_out, registers, uses;
  double key;                 /* as of grounds: of another function there are no numbers */
} Lanes;

static Lanes lanes[SLOTS];

#ifdef __GNUC__
#define POINTS _Pragma("GCC ivdep") for (i = 0; i < WIDTH; i++)
#else
#define POINTS for (i = 0; i < WIDTH; i++)
#endif
#define UNARY(OPERATION, VALUE) case OPERATION: POINTS { double x = a[i]; r[i] = VALUE; } break;
#define BINARY(OPERATION, VALUE)                                                                   \
  case OPERATION: POINTS { double x = a[i], y = b[i]; r[i] = VALUE; } break;

/* In the order of OPERATIONS in kernel.py; registers of WIDTH numbers are in `w`. */
#if defined(__GNUC__) && !defined(__clang__) && defined(__x86_64__) && defined(__linux__)
__attribute__((target_clones("avx2", "default")))
#endif
static int run_lanes(const Lanes *f, const double **arg, double **res, double *w) {
  const double *key = arg[f->n_in - 1];
  int is_known = key && *key == f->key;
  casadi_int begin, k, i;
  for (k = 0; k < f->n_out; k++) {
    const casadi_int *shape = f->shapes + 3 * (f->n_in + k);
    for (i = 0; res[k] && i < shape[0] * shape[1]; i++) res[k][i] = is_known ? 0 : NAN;
  }
  if (!is_known) return 0;
  for (begin = 0; begin < f->points; begin += WIDTH) {
    casadi_int left = f->points - begin < WIDTH ? f->points - begin : WIDTH;
    const int *code = f->code;
    for (k = 0; k < f->length; k++, code += 4) {
      double *r = w + WIDTH * code[1];
      const double *a = w + WIDTH * code[2], *b = w + WIDTH * code[3];
      switch (code[0]) {
        case 0: { /* from an argument, with a row for each point or one for all */
          casadi_int rows = f->shapes[3 * code[2]];
          const double *from = arg[code[2]] ? arg[code[2]] + rows * code[3] : NULL;
          for (i = 0; i < WIDTH; i++)
            r[i] = from ? from[rows == 1 ? 0 : begin + (i < left ? i : left - 1)] : 0;
          break;
        }
        case 1: /* to a result */
          if (res[code[1]])
            memcpy(res[code[1]] + f->points * code[3] + begin, a, (size_t)left * sizeof(double));
          break;
        case 2: POINTS r[i] = f->numbers[k]; break;
        UNARY(3, x)
        BINARY(4, x + y)
        BINARY(5, x - y)
        BINARY(6, x * y)
        BINARY(7, x / y)
        UNARY(8, -x)
        UNARY(9, x * x)
        UNARY(10, 2 * x)
        UNARY(11, 1 / x)
        UNARY(12, sqrt(x))
        UNARY(13, sin(x))
        UNARY(14, cos(x))
        UNARY(15, tan(x))
        UNARY(16, asin(x))
        UNARY(17, acos(x))
        UNARY(18, atan(x))
        BINARY(19, atan2(x, y))
        UNARY(20, exp(x))
        UNARY(21, log(x))
        BINARY(22, pow(x, y))
        BINARY(23, pow(x, y))
        UNARY(24, fabs(x))
        UNARY(25, x < 0 ? -1 : x > 0 ? 1 : x)
        BINARY(26, fmin(x, y))
        BINARY(27, fmax(x, y))
        BINARY(28, x < y)
        BINARY(29, x <= y)
        BINARY(30, x == y)
        BINARY(31, x != y)
        UNARY(32, !x)
        BINARY(33, x && y)
        BINARY(34, x || y)
        BINARY(35, x ? y : 0)
        UNARY(36, floor(x))
        UNARY(37, tanh(x))
        BINARY(38, hypot(x, y))
        UNARY(39, expm1(x))
        UNARY(40, log1p(x))
        UNARY(41, sinh(x))
        UNARY(42, cosh(x))
        UNARY(43, ceil(x))
        BINARY(44, fmod(x, y))
        BINARY(45, copysign(x, y))
        UNARY(46, erf(x))
        default: return 1;
      }
    }
  }
  return 0;
}

#define LANES(N)                                                                                   \
  API casadi_int lanes##N##_n_in(void) { return lanes[N].n_in; }                                   \
  API casadi_int lanes##N##_n_out(void) { return lanes[N].n_out; }                                 \
  API const casadi_int *lanes##N##_sparsity_in(casadi_int k) { return lanes[N].shapes + 3 * k; }   \
  API const casadi_int *lanes##N##_sparsity_out(casadi_int k) {                                    \
    return lanes[N].shapes + 3 * (lanes[N].n_in + k);                                              \
  }                                                                                                \
  API void lanes##N##_incref(void) { lanes[N].uses++; }                                            \
  API void lanes##N##_decref(void) { lanes[N].uses--; }                                            \
  API int lanes##N##_work(casadi_int *args, casadi_int *results, casadi_int *iw, casadi_int *w) {  \
    *args = lanes[N].n_in, *results = lanes[N].n_out, *iw = 0;                                     \
    *w = WIDTH * lanes[N].registers;                                                               \
    return 0;                                                                                      \
  }                                                                                                \
  API int lanes##N(const double **arg, double **res, casadi_int *iw, double *w, int mem) {         \
    (void)iw, (void)mem;                                                                           \
    return run_lanes(&lanes[N], arg, res, w);                                                      \
  }

/* Dense columns in CasADi's layout: rows, columns, 1. */
static const casadi_int POINT[] = {3, 1, 1}, CELL[] = {18, 1, 1}, WHEEL[] = {10, 1, 1},
  NEAREST[] = {13, 1, 1};

#define FUNCTION(NAME, N, INPUT, OUTPUT, COMPUTE)                                                  \
  API casadi_int NAME##N##_n_in(void) { return 1; }                                                \
  API casadi_int NAME##N##_n_out(void) { return 1; }                                               \
  API const casadi_int *NAME##N##_sparsity_in(casadi_int k) { return k ? NULL : INPUT; }           \
  API const casadi_int *NAME##N##_sparsity_out(casadi_int k) { return k ? NULL : OUTPUT; }         \
  API void NAME##N##_incref(void) { grounds[N].uses++; }                                           \
  API void NAME##N##_decref(void) { grounds[N].uses--; }                                           \
  API int NAME##N(const double **arg, double **res, casadi_int *iw, double *w, int mem) {          \
    (void)iw, (void)w, (void)mem;                                                                  \
    return COMPUTE(&grounds[N], arg, res[0]);                                                      \
  }
#define SLOT(N)                                                                                    \
  FUNCTION(ground, N, POINT, CELL, polynomial)                                                     \
  FUNCTION(nearest, N, WHEEL, NEAREST, nearest)                                                    \
  LANES(N)
SLOT(0) SLOT(1) SLOT(2) SLOT(3) SLOT(4) SLOT(5) SLOT(6) SLOT(7) SLOT(8) SLOT(9)
SLOT(10) SLOT(11) SLOT(12) SLOT(13) SLOT(14) SLOT(15) SLOT(16) SLOT(17) SLOT(18) SLOT(19)
SLOT(20) SLOT(21) SLOT(22) SLOT(23) SLOT(24) SLOT(25) SLOT(26) SLOT(27) SLOT(28) SLOT(29)
SLOT(30) SLOT(31) SLOT(32) SLOT(33) SLOT(34) SLOT(35) SLOT(36) SLOT(37) SLOT(38) SLOT(39)
SLOT(40) SLOT(41) SLOT(42) SLOT(43) SLOT(44) SLOT(45) SLOT(46) SLOT(47) SLOT(48) SLOT(49)
SLOT(50) SLOT(51) SLOT(52) SLOT(53) SLOT(54) SLOT(55) SLOT(56) SLOT(57) SLOT(58) SLOT(59)
SLOT(60) SLOT(61) SLOT(62) SLOT(63)

API int kernel_layout(void) { return LAYOUT; }

API int kernel_slots(void) { return SLOTS; }

API int kernel_in_use(int slot) { return grounds[slot].uses != 0; }

API void kernel_close(int slot) { grounds[slot].table = NULL; }

/* Numbers: key, x, y, h_x, h_y, first_i, first_j, last_i, last_j. */
API void kernel_open(int slot, const double *table, casadi_int width, const double *numbers) {
  Ground *g = &grounds[slot];
  g->table = table;
  g->width = width;
  g->key = numbers[0];
  g->x = numbers[1];
  g->y = numbers[2];
  g->h_x = numbers[3];
  g->h_y = numbers[4];
  g->first_i = numbers[5];
  g->first_j = numbers[6];
  g->last_i = numbers[7];
  g->last_j = numbers[8];
}

API int kernel_lanes_in_use(int slot) { return lanes[slot].uses != 0; }

/* Sizes: operations, points, arguments with the key, results, registers, key. */
API void kernel_open_lanes(int slot, const int *code, const double *numbers, const casadi_int *shapes,
                           const casadi_int *sizes) {
  Lanes f = {code, sizes[0], sizes[1], numbers, shapes, sizes[2], sizes[3], sizes[4], 0, sizes[5]};
  lanes[slot] = f;
}

/* Heights at n local points. */
API void kernel_heights(int slot, casadi_int n, const double *x, const double *y, double *heights) {
  casadi_int k;
  for (k = 0; k < n; k++) heights[k] = height(&grounds[slot], x[k], y[k]);
}

/* Drop of the vertex of a parabola through a gap and its two neighbours below the gap. */
static double drop(double before, double at, double after) {
  double slope = (after - before) / 2, bend = after - 2 * at + before;
  return bend > 0 ? slope * slope / (2 * bend) : 0;
}

/* The points of a wheel's tread, middles (across, 3) + radii (across) * spokes, and their
 * gaps (rim, across) to the ground, those of a row of the rim as they are needed. A spoke is the sum of two vectors
 * turned (2, 3), times cosine and sine of its angle, circle (rim, 2). */
typedef struct {
  const Ground *ground;
  casadi_int rim, across;
  const double *middles, *radii, *turned, *circle;
  double *gap, *known; /* the gaps, and which rows are known */
} Tread;

static void spoke_of(const Tread *t, casadi_int i, double spoke[3]) {
  int k;
  for (k = 0; k < 3; k++) spoke[k] = t->circle[2 * i] * t->turned[k] + t->circle[2 * i + 1] * t->turned[3 + k];
}

static void extend(double ends[2], double low, double high) {
  if (!(low >= ends[0])) ends[0] = low;
  if (!(high <= ends[1])) ends[1] = high;
}

/* Bound of the heights between ends in x and y: a spline lies below the largest coefficient of its cells.
 * Beyond the map, where polynomials continue, there is none. */
static double highest(const Ground *g, double ends[2][2]) {
  double top = -INFINITY, a[2], b[2], m[2], n[2];
  const double *first = corner(g, ends[0][0], ends[1][0], a, b, m, n), *c;
  casadi_int k, l, rows, columns;
  corner(g, ends[0][1], ends[1][1], a + 1, b + 1, m + 1, n + 1);
  if (!(*a >= *m && *b >= *n && a[1] <= m[1] + 1 && b[1] <= n[1] + 1)) return INFINITY;
  rows = (casadi_int)(m[1] - *m) + 4, columns = (casadi_int)(n[1] - *n) + 4;
  for (k = 0; k < rows; k++)
    for (c = first + k * g->width, l = 0; l < columns; l++)
      if (c[l] > top) top = c[l];
  return top * 36;
}

/* Bound of the heights under a wheel. */
static double highest_under(const Tread *t) {
  double ends[2][2] = {{INFINITY, -INFINITY}, {INFINITY, -INFINITY}};
  casadi_int j, k;
  for (j = 0; j < t->across; j++)
    for (k = 0; k < 2; k++) {
      double at = t->middles[3 * j + k];
      extend(ends[k], at - t->radii[j], at + t->radii[j]);
    }
  return highest(t->ground, ends);
}

/* Whether the gaps of a row are known to exceed a number; `top` is the bound of the heights under the wheel. */
static int is_far(const Tread *t, casadi_int i, double top, double gap) {
  double low = INFINITY, ends[2][2] = {{INFINITY, -INFINITY}, {INFINITY, -INFINITY}}, spoke[3];
  casadi_int j, k;
  spoke_of(t, i, spoke);
  for (j = 0; j < t->across; j++) {
    double at = t->middles[3 * j + 2] + t->radii[j] * spoke[2];
    if (!(at >= low)) low = at;
  }
  if (low - top > gap) return 1;
  for (j = 0; j < t->across; j++)
    for (k = 0; k < 2; k++) {
      double at = t->middles[3 * j + k] + t->radii[j] * spoke[k];
      extend(ends[k], at, at);
    }
  return low - highest(t->ground, ends) > gap;
}

static void compute_row(const Tread *t, casadi_int i) {
  double spoke[3];
  casadi_int j;
  if (i < 0 || i >= t->rim || t->known[i]) return;
  t->known[i] = 1;
  spoke_of(t, i, spoke);
  for (j = 0; j < t->across; j++) {
    const double *middle = t->middles + 3 * j;
    double r = t->radii[j];
    t->gap[i * t->across + j] = middle[2] + r * spoke[2]
                                - height(t->ground, middle[0] + r * spoke[0], middle[1] + r * spoke[1]);
  }
}

/* The smallest of `best` and the gaps of a row that are second minima, refined by parabolas, or
 * inside the ground; `_smallest_gaps` of contact/certify.py does the same. */
static double smallest_of_row(const Tread *t, casadi_int i, double touching, double near, double best,
                              casadi_int *index) {
  casadi_int j, k, l, rim = t->rim, across = t->across, middle_i = rim / 2, middle_j = across / 2;
  for (k = -1; k < 2; k++) compute_row(t, i + k);
  for (j = 0; j < across; j++) {
    const double *at = t->gap + i * across + j;
    double value = *at;
    int low = i < middle_i - 1 || i > middle_i + 1 || j < middle_j - 1 || j > middle_j + 1;
    for (k = i ? -1 : 0; low && k <= (i < rim - 1); k++)
      for (l = j ? -1 : 0; low && l <= (j < across - 1); l++) low = *at <= at[k * across + l];
    if (!low && !(value < -touching)) continue;
    if (low && value < near) {
      if (i > 0 && i < rim - 1) value -= drop(at[-across], *at, at[across]);
      if (j > 0 && j < across - 1) value -= drop(at[-1], *at, at[1]);
    }
    if (value < best) {
      best = value;
      *index = i * across + j;
    }
  }
  return best;
}

/* For n wheels: the smallest gap of `smallest_of_row` below the value of `best` at the call, or that
 * value. From the contact outwards, rows of the rim are searched whose bound does not exceed the
 * smallest gap so far, and `near`. `work` has rim (across + 1) numbers. */
API void kernel_gaps(int slot, casadi_int n, casadi_int rim, casadi_int across, const double *middles,
                     const double *radii, const double *turned, const double *circle, double touching,
                     double near, double *work, double *best, casadi_int *index) {
  casadi_int w, i, k;
  for (w = 0; w < n; w++) {
    Tread t = {&grounds[slot], rim, across, middles + 3 * w * across, radii + w * across,
               turned + 6 * w, circle, work, work + rim * across};
    double most = best[w], top = highest_under(&t);
    index[w] = 0;
    for (i = 0; i < rim; i++) t.known[i] = 0;
    for (k = 0; k < rim; k++) {
      i = rim / 2 + (k % 2 ? -(k + 1) / 2 : k / 2);
      if (!is_far(&t, i, top, fmin(fmax(best[w], near), most)))
        best[w] = smallest_of_row(&t, i, touching, near, best[w], index + w);
    }
  }
}

/* Interval arithmetic, rounded outward as in core/interval.py. Bounds that are not numbers stay so. */
#define ROUNDING 4.440892098500626e-16 /* 2^-51 */
#define TINY 1e-300
#define LIBRARY_ERROR 8.881784197001252e-16 /* 2^-50, of sine and cosine */
#define NEAR_EXTREME 1e-9
#define PI 3.141592653589793
#define EDGE 1e-6 /* that of enclosure/wheel_gaps.py */

typedef struct {
  double low, high;
} Interval;

static double lower(double a, double b) { return a < b || a != a ? a : b; }
static double higher(double a, double b) { return a > b || a != a ? a : b; }

static Interval outward(double low, double high, double tiny) {
  Interval r;
  r.low = low - (fabs(low) * ROUNDING + tiny);
  r.high = high + (fabs(high) * ROUNDING + tiny);
  return r;
}

static Interval plus(Interval a, Interval b) { return outward(a.low + b.low, a.high + b.high, 0); }
static Interval minus(Interval a, Interval b) { return outward(a.low - b.high, a.high - b.low, 0); }
static double magnitude(Interval a) { return higher(fabs(a.low), fabs(a.high)); }
static int has_zero(Interval a) { return !(a.low > 0 || a.high < 0); }

static Interval exactly(double a) {
  Interval r = {a, a};
  return r;
}

static Interval negative(Interval a) {
  Interval r = {-a.high, -a.low};
  return r;
}

static Interval times(Interval a, Interval b) {
  double p = a.low * b.low, q = a.high * b.high, r = a.low * b.high, s = a.high * b.low;
  return outward(lower(lower(p, q), lower(r, s)), higher(higher(p, q), higher(r, s)), TINY);
}

/* Cosine (shift 0) or sine (shift 0.5), whose maxima are at `shift` half turns and full turns. */
static Interval wave(Interval a, double (*function)(double), double shift) {
  double p = function(a.low), q = a.high > a.low ? function(a.high) : p, near = NEAR_EXTREME * (1 + magnitude(a));
  double first = a.low / PI - shift - near, last = a.high / PI - shift + near;
  Interval r;
  r.low = higher(lower(p, q) - LIBRARY_ERROR, -1);
  r.high = lower(higher(p, q) + LIBRARY_ERROR, 1);
  if (2 * ceil((first - 1) / 2) + 1 <= last) r.low = -1;
  if (2 * ceil(first / 2) <= last) r.high = 1;
  return r;
}

static Interval inner(const Interval *a, const Interval *b) {
  return plus(plus(times(a[0], b[0]), times(a[1], b[1])), times(a[2], b[2]));
}

/* A map and its bounds, as `GroundRange` of enclosure/ground_range.py has them. */
typedef struct {
  const double *table;                  /* 36 times the coefficients, y fastest [m] */
  casadi_int count[2];                  /* cells along x and y */
  const double *place, *spacing, *node; /* along x and y */
  casadi_int levels;                    /* of windows, numbered from zero */
  const double *const *largest;         /* by level: six derivatives of all cells, or NULL */
  const unsigned char *const *missing;  /* by level: whether cells touch holes, or NULL */
} Range;

typedef struct {
  double height, slope[2], second[3], error[3], inexact, a[2];
  casadi_int cell[2];
} Jets;

static double smaller_spacing(const Range *m) {
  return m->spacing[0] < m->spacing[1] ? m->spacing[0] : m->spacing[1];
}

static Jets jets_at(const Range *m, const double *at) {
  Jets r;
  double b[2][3][4], partial[3][4], top = 0, step = smaller_spacing(m);
  casadi_int axis, i, j, p;
  r.inexact = 0;
  for (axis = 0; axis < 2; axis++) {
    double h = m->spacing[axis], a = (at[axis] - m->place[axis]) / h + m->node[axis], u, v, c;
    c = floor(a);
    if (!(c >= 0)) c = 0;
    if (c > (double)(m->count[axis] - 1)) c = (double)(m->count[axis] - 1);
    r.a[axis] = a;
    r.cell[axis] = (casadi_int)c;
    r.inexact = higher(r.inexact, 8.881784197001252e-16 * h * (fabs(a) + m->node[axis] + 2));
    u = a - c;
    v = 1 - u;
    b[axis][0][0] = v * v * v;
    b[axis][0][1] = 4 + 3 * (u * u * u - 2 * (u * u));
    b[axis][0][2] = 4 + 3 * (v * v * v - 2 * (v * v));
    b[axis][0][3] = u * u * u;
    b[axis][1][0] = -3 * (v * v) / h;
    b[axis][1][1] = 3 * u * (3 * u - 4) / h;
    b[axis][1][2] = 3 * v * (4 - 3 * v) / h;
    b[axis][1][3] = 3 * (u * u) / h;
    b[axis][2][0] = 6 * v / (h * h);
    b[axis][2][1] = (18 * u - 12) / (h * h);
    b[axis][2][2] = (18 * v - 12) / (h * h);
    b[axis][2][3] = 6 * u / (h * h);
  }
  for (j = 0; j < 4; j++)
    for (p = 0; p < 3; p++) partial[p][j] = 0;
  for (i = 0; i < 4; i++) {
    const double *c = m->table + (r.cell[0] + i) * (m->count[1] + 3) + r.cell[1];
    for (j = 0; j < 4; j++) {
      top = higher(top, fabs(c[j]));
      for (p = 0; p < 3; p++) partial[p][j] += b[0][p][i] * c[j];
    }
  }
#define SUM(p, q) \
  ((b[1][q][0] * partial[p][0] + b[1][q][1] * partial[p][1] + b[1][q][2] * partial[p][2] \
    + b[1][q][3] * partial[p][3]) / 36)
  r.height = SUM(0, 0);
  r.slope[0] = SUM(1, 0);
  r.slope[1] = SUM(0, 1);
  r.second[0] = SUM(2, 0);
  r.second[1] = SUM(1, 1);
  r.second[2] = SUM(0, 2);
#undef SUM
  top *= 100 * 1.1102230246251565e-16;
  r.error[0] = top;
  r.error[1] = 2 * top / step;
  r.error[2] = 6 * top / (step * step);
  return r;
}

/* Number of the smallest window that covers a reach; `missed` grows to it if it is not known yet. */
static casadi_int level_of(const Range *m, double reach, casadi_int *missed) {
  double cells = ceil(reach / smaller_spacing(m)), size = 1;
  casadi_int level = 1;
  if (!(cells <= 1e9)) return m->levels;
  for (; size < cells && level < m->levels; size *= 2) level++;
  if (level < m->levels && !m->largest[level] && level > *missed) *missed = level;
  return level;
}

/* The largest third derivatives within a reach of a point. */
static void third_bounds(const Range *m, const Jets *jets, double dx, double dy, double *t,
                         casadi_int *missed) {
  casadi_int k, level = level_of(m, higher(dx, dy) + jets->inexact, missed);
  casadi_int all = m->count[0] * m->count[1], cell = jets->cell[0] * m->count[1] + jets->cell[1];
  for (k = 0; k < 4; k++)
    t[k] = level < m->levels && m->largest[level] ? m->largest[level][k * all + cell] : INFINITY;
}

static Interval height_near(const Range *m, const Jets *jets, double reach_x, double reach_y,
                            casadi_int *missed) {
  double dx = reach_x + jets->inexact, dy = reach_y + jets->inexact, t[4], away;
  double gx = fabs(jets->slope[0]) + jets->error[1], gy = fabs(jets->slope[1]) + jets->error[1];
  double xx = fabs(jets->second[0]) + jets->error[2], xy = fabs(jets->second[1]) + jets->error[2];
  double yy = fabs(jets->second[2]) + jets->error[2];
  third_bounds(m, jets, reach_x, reach_y, t, missed);
  away = gx * dx + gy * dy + (xx * (dx * dx) + 2 * xy * dx * dy + yy * (dy * dy)) / 2
         + (t[0] * (dx * dx * dx) + 3 * t[1] * (dx * dx) * dy + 3 * t[2] * dx * (dy * dy)
            + t[3] * (dy * dy * dy)) / 6;
  away = (away + jets->error[0]) * (1 + 1e-14);
  return outward(jets->height - away, jets->height + away, TINY);
}

static void slopes_near(const Range *m, const Jets *jets, const Interval *away, Interval *slope,
                        casadi_int *missed) {
  Interval box[2];
  double t[4], dx, dy;
  casadi_int k;
  for (k = 0; k < 2; k++) {
    box[k].low = away[k].low - jets->inexact;
    box[k].high = away[k].high + jets->inexact;
  }
  dx = magnitude(box[0]);
  dy = magnitude(box[1]);
  third_bounds(m, jets, dx, dy, t, missed);
  for (k = 0; k < 2; k++) {
    double rest = (t[k] * (dx * dx) + 2 * t[k + 1] * dx * dy + t[k + 2] * (dy * dy)) / 2;
    Interval more;
    rest = (rest + jets->error[1] + jets->error[2] * (dx + dy)) * (1 + 1e-14);
    more.low = -rest;
    more.high = rest;
    slope[k] = plus(times(box[0], exactly(jets->second[k])), times(box[1], exactly(jets->second[k + 1])));
    slope[k] = plus(plus(slope[k], exactly(jets->slope[k])), more);
  }
}

/* Whether the ground is known at a point (1), and in the square of a half-size about it (2). */
static int known_near(const Range *m, const Jets *jets, double reach, casadi_int *missed) {
  int point = 1, square = 1;
  casadi_int axis, level = level_of(m, reach, missed);
  casadi_int cell = jets->cell[0] * m->count[1] + jets->cell[1];
  for (axis = 0; axis < 2; axis++) {
    double a = jets->a[axis], away = reach / m->spacing[axis] + 1e-9, last = (double)m->count[axis];
    point = point && a >= 0 && a <= last;
    square = square && a >= away && a + away <= last;
  }
  point = point && !m->missing[0][cell];
  square = square && level < m->levels && m->missing[level] && !m->missing[level][cell];
  return point + 2 * square;
}

/* Points of a tread in the frame of its carrier, and derivatives by both angles. */
static void tread_at(const double *radii, const Interval *angles, Interval *point, Interval *turned,
                     Interval *rolled) {
  Interval cos_v = wave(angles[0], cos, 0), sin_v = wave(angles[0], sin, 0.5);
  Interval cos_u = wave(angles[1], cos, 0), sin_u = wave(angles[1], sin, 0.5);
  Interval axial = times(cos_u, exactly(radii[0])), away = times(sin_u, exactly(radii[0]));
  Interval rho = plus(away, exactly(radii[1]));
  point[0] = axial;
  point[1] = times(rho, cos_v);
  point[2] = times(rho, sin_v);
  turned[0] = exactly(0);
  turned[1] = negative(point[2]);
  turned[2] = point[1];
  rolled[0] = negative(away);
  rolled[1] = times(axial, cos_v);
  rolled[2] = times(axial, sin_v);
}

/* A row of bounds: `arrays` are six of lower bounds, then those of upper bounds. */
static Interval taken(const double *const *arrays, casadi_int number, casadi_int row, casadi_int all,
                      casadi_int at) {
  Interval r;
  r.low = arrays[number][row * all + at];
  r.high = arrays[number + 6][row * all + at];
  return r;
}

static void pose_of(const double *const *arrays, casadi_int number, casadi_int all, casadi_int at,
                    Interval *center, Interval rotation[3][3]) {
  casadi_int i, j;
  for (i = 0; i < 3; i++) {
    center[i] = taken(arrays, number, i, all, at);
    for (j = 0; j < 3; j++) rotation[i][j] = taken(arrays, number + 1, 3 * i + j, all, at);
  }
}

static void placed(const Interval *center, Interval rotation[3][3], const Interval *spot, Interval *place) {
  casadi_int i, j;
  for (i = 0; i < 3; i++) {
    place[i] = center[i];
    for (j = 0; j < 3; j++) place[i] = plus(place[i], times(rotation[i][j], spot[j]));
  }
}

/* What `_examine` of enclosure/wheel_gaps.py says, for n patches: bounds of the gap at the middle of
 * the box and an upper one at that of the patch, in three rows; and flags, of which 1 tells that
 * the patch may touch first, 2 that the ground is known under its middle, and 4 under all of it.
 * `arrays` are lower and upper bounds at the wheels and boxes: centers and rotations at the middles,
 * those over the boxes, reference points, and slopes under them; then turns, shifts, and gaps.
 * Returns the highest level of windows that was missing, or zero. */
API int kernel_patches(const double *table, const casadi_int *count, const double *axes,
                              casadi_int levels, const double *const *largest,
                              const unsigned char *const *missing, casadi_int wheels, casadi_int lanes,
                              casadi_int n, const double *const *arrays, const double *radii,
                              const casadi_int *lane, const casadi_int *wheel, const double *middle,
                              const double *half, double *gaps, unsigned char *flags) {
  Range m = {table, {count[0], count[1]}, axes, axes + 2, axes + 4, levels, largest, missing};
  const double *turn = arrays[12], *shift = arrays[13];
  casadi_int all = wheels * lanes, k, i, missed = 0;
  for (k = 0; k < n; k++) {
    casadi_int at = wheel[k] * lanes + lane[k];
    double own[2] = {radii[wheel[k]], radii[wheels + wheel[k]]}, center[2], spread, apart[3], tilt[3];
    double xy = turn[at], xz = turn[all + at], yz = turn[2 * all + at], change, limit, u = middle[n + k];
    Interval angles[2], spot[3], turned[3], rolled[3], thin[3], place[3], away[2], slope[2], normal[3];
    Interval base[3], rotation[3][3], around, across, point, gap;
    Jets jets;
    int known, inside, higher_up, changes;
    for (i = 0; i < 2; i++) angles[i] = exactly(middle[i * n + k]);
    tread_at(own, angles, spot, turned, rolled);
    pose_of(arrays, 0, all, at, base, rotation);
    placed(base, rotation, spot, thin);
    for (i = 0; i < 2; i++)
      angles[i] = outward(middle[i * n + k] - half[i * n + k], middle[i * n + k] + half[i * n + k], TINY);
    tread_at(own, angles, spot, turned, rolled);
    pose_of(arrays, 2, all, at, base, rotation);
    placed(base, rotation, spot, place);
    for (i = 0; i < 2; i++) {
      center[i] = (thin[i].low + thin[i].high) / 2;
      thin[i] = minus(thin[i], exactly(center[i]));
      away[i] = minus(place[i], exactly(center[i]));
    }
    jets = jets_at(&m, center);
    slopes_near(&m, &jets, away, slope, &missed);
    known = known_near(&m, &jets, higher(magnitude(away[0]), magnitude(away[1])), &missed);
    for (i = 0; i < 3; i++) {
      normal[i] = minus(rotation[2][i], times(rotation[0][i], slope[0]));
      normal[i] = minus(normal[i], times(rotation[1][i], slope[1]));
      apart[i] = magnitude(minus(spot[i], taken(arrays, 4, i, all, at)));
      tilt[i] = magnitude(normal[i]);
    }
    around = inner(normal, turned);
    across = inner(normal, rolled);
    spread = (magnitude(around) * half[k] + magnitude(across) * half[n + k]) * (1 + 1e-12);
    point = minus(thin[2], height_near(&m, &jets, magnitude(thin[0]), magnitude(thin[1]), &missed));
    gap = outward(point.low - spread, point.high + spread, 0);
    change = tilt[0] * (xy * apart[1] + xz * apart[2]) + tilt[1] * (xy * apart[0] + yz * apart[2])
             + tilt[2] * (xz * apart[0] + yz * apart[1]);
    for (i = 0; i < 2; i++)
      change += magnitude(minus(slope[i], taken(arrays, 5, i, all, at))) * shift[i * all + at];
    limit = arrays[14][at] + change;
    higher_up = gap.low > limit + 1e-12 * (fabs(limit) + change);
    inside = u - half[n + k] > EDGE && u + half[n + k] < PI - EDGE;
    changes = !has_zero(around) || (!has_zero(across) && inside);
    gaps[k] = gap.low;
    gaps[n + k] = gap.high;
    gaps[2 * n + k] = point.high;
    flags[k] = (unsigned char)((!(known & 2) || !(higher_up || changes)) + 2 * known);
  }
  return (int)missed;
}

#ifdef _WIN32
API void *PyInit__kernel(void) { return NULL; } /* the linker is told to export it */
#endif
