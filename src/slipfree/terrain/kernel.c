/* Bicubic spline grounds in plain C: height and derivatives at a point, as CasADi calls external
 * functions. `kernel.py` opens grounds and says what the numbers mean; `bicubic.py` does the same
 * sums without a compiler, and is what this is tested against.
 *
 * Every ground that is open has a slot, whose functions carry its number in their names: groundN,
 * from (x, y, key) to (h, h_x, h_y, h_xx, h_xy, h_yy); jac_groundN and jac_jac_groundN, its first
 * and second Jacobians in CasADi's layout. CasADi counts its own uses of them (incref, decref); a
 * slot in use is not given away. The key tells grounds apart that have had the same slot: functions
 * of another one, say from another process, give no number instead of its heights.
 */
#include <math.h>
#include <stddef.h>

#ifdef _WIN32
#define API __declspec(dllexport)
#else
#define API __attribute__((visibility("default")))
#endif

#define SLOTS 64
#define LAYOUT 1 /* of the numbers below; kernel.py expects it */
#define ON_KNOT 1e-10 /* a point nearer to a knot than this, in cells, lies on it */

typedef long long int casadi_int;

typedef struct {
  const double *table;         /* coefficients in units, y fastest */
  casadi_int width;            /* of a row of the table */
  double unit, key, x, y;      /* x, y: local place of the node nearest to the local origin [m] */
  double h_x, h_y;             /* spacing [m] */
  double first_i, first_j;     /* that node's numbers */
  double last_i, last_j;       /* the last cell's */
  casadi_int uses;
} Ground;

static Ground grounds[SLOTS];

/* Order of the derivatives in x and in y of the six entries of a jet. */
static const int IN_X[6] = {0, 1, 0, 2, 1, 0}, IN_Y[6] = {0, 0, 1, 0, 1, 2};

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

/* fmin and fmax put NaN into a valid cell, whose polynomial then returns NaN. */
static double cell(double a, double first, double last) {
  return fmin(fmax(floor(a + ON_KNOT), -first), last - first);
}

/* Derivatives of the height up to a total order, d[m][n] of orders m in x and n in y. Those of
 * order four and higher in one direction are zero, and left alone. */
static void derivatives(const Ground *g, double x, double y, int total, double d[4][4]) {
  double a = (x - g->x) / g->h_x, b = (y - g->y) / g->h_y;
  double i = cell(a, g->first_i, g->last_i), j = cell(b, g->first_j, g->last_j);
  double in_x[4][4], in_y[4][4], line[4], scale_x = g->unit, scale;
  const double *c = g->table + (casadi_int)(i + g->first_i) * g->width + (casadi_int)(j + g->first_j);
  int m, n, k, order = total < 3 ? total : 3;
  basis(a - i, order, in_x);
  basis(b - j, order, in_y);
  for (m = 0; m <= order; m++) {
    for (k = 0; k < 4; k++)
      line[k] = in_x[m][0] * c[k] + in_x[m][1] * c[g->width + k] + in_x[m][2] * c[2 * g->width + k]
              + in_x[m][3] * c[3 * g->width + k];
    scale = scale_x;
    for (n = 0; n <= order && m + n <= total; n++) {
      d[m][n] = scale * (line[0] * in_y[n][0] + line[1] * in_y[n][1] + line[2] * in_y[n][2]
                         + line[3] * in_y[n][3]);
      scale /= g->h_y;
    }
    scale_x /= g->h_x;
  }
}

static double entry(double d[4][4], int m, int n) { return m > 3 || n > 3 ? 0 : d[m][n]; }

/* What is not this ground's gets NaN, not an error: CasADi's SX functions do not look at what a
 * called function returns, and take what they find in its place. */
static int refused(const Ground *g, const double **arg, double *res, int count) {
  if (g->table && arg[0] && arg[0][2] == g->key) return 0;
  while (count--) res[count] = NAN;
  return 1;
}

static int jet(const Ground *g, const double **arg, double **res) {
  double d[4][4];
  int k;
  if (!res[0]) return 0;
  if (refused(g, arg, res[0], 6)) return 0;
  derivatives(g, arg[0][0], arg[0][1], 2, d);
  for (k = 0; k < 6; k++) res[0][k] = d[IN_X[k]][IN_Y[k]];
  return 0;
}

static int jacobian(const Ground *g, const double **arg, double **res) {
  double d[4][4];
  int k;
  if (!res[0]) return 0;
  if (refused(g, arg, res[0], 18)) return 0;
  derivatives(g, arg[0][0], arg[0][1], 3, d);
  for (k = 0; k < 6; k++) {
    res[0][k] = d[IN_X[k] + 1][IN_Y[k]];
    res[0][6 + k] = d[IN_X[k]][IN_Y[k] + 1];
    res[0][12 + k] = 0;
  }
  return 0;
}

/* Entry (p + 6 q, r) is the derivative of entry p of the jet in coordinates q and r. */
static int second(const Ground *g, const double **arg, double **res) {
  double d[4][4];
  int k;
  if (!res[0]) return 0;
  if (refused(g, arg, res[0], 54)) return 0;
  derivatives(g, arg[0][0], arg[0][1], 4, d);
  for (k = 0; k < 54; k++) res[0][k] = 0;
  for (k = 0; k < 6; k++) {
    res[0][k] = entry(d, IN_X[k] + 2, IN_Y[k]);
    res[0][6 + k] = res[0][18 + k] = entry(d, IN_X[k] + 1, IN_Y[k] + 1);
    res[0][24 + k] = entry(d, IN_X[k], IN_Y[k] + 2);
  }
  return 0;
}

/* Sparsity in CasADi's layout: rows, columns, where columns begin, rows of the entries. */
#define SIX 0, 1, 2, 3, 4, 5
#define EIGHTEEN SIX, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15, 16, 17
static const casadi_int POINT[] = {3, 1, 0, 3, 0, 1, 2}, JET[] = {6, 1, 0, 6, SIX},
  JACOBIAN[] = {6, 3, 0, 6, 12, 18, SIX, SIX, SIX},
  SECOND[] = {18, 3, 0, 18, 36, 54, EIGHTEEN, EIGHTEEN, EIGHTEEN},
  EMPTY[] = {18, 6, 0, 0, 0, 0, 0, 0, 0};
static const casadi_int *const IN[] = {POINT, JET, JACOBIAN};

#define FUNCTION(NAME, N, INPUTS, OUTPUTS, FIRST, SUM)                                             \
  API casadi_int NAME##_n_in(void) { return INPUTS; }                                              \
  API casadi_int NAME##_n_out(void) { return OUTPUTS; }                                            \
  API const casadi_int *NAME##_sparsity_in(casadi_int k) { return IN[k]; }                         \
  API const casadi_int *NAME##_sparsity_out(casadi_int k) { return k ? EMPTY : FIRST; }            \
  API void NAME##_incref(void) { grounds[N].uses++; }                                              \
  API void NAME##_decref(void) { grounds[N].uses--; }                                              \
  API int NAME(const double **arg, double **res, casadi_int *iw, double *w, int mem) {             \
    (void)iw, (void)w, (void)mem;                                                                  \
    return SUM(&grounds[N], arg, res);                                                             \
  }
#define SLOT(N)                                                                                    \
  FUNCTION(ground##N, N, 1, 1, JET, jet)                                                           \
  FUNCTION(jac_ground##N, N, 2, 1, JACOBIAN, jacobian)                                             \
  FUNCTION(jac_jac_ground##N, N, 3, 2, SECOND, second)
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

/* Numbers: unit, key, x, y, h_x, h_y, first_i, first_j, last_i, last_j. */
API void kernel_open(int slot, const double *table, casadi_int width, const double *numbers) {
  Ground *g = &grounds[slot];
  g->table = table;
  g->width = width;
  g->unit = numbers[0];
  g->key = numbers[1];
  g->x = numbers[2];
  g->y = numbers[3];
  g->h_x = numbers[4];
  g->h_y = numbers[5];
  g->first_i = numbers[6];
  g->first_j = numbers[7];
  g->last_i = numbers[8];
  g->last_j = numbers[9];
}

/* Heights at n local points. */
API void kernel_heights(int slot, casadi_int n, const double *x, const double *y, double *height) {
  double d[4][4];
  casadi_int k;
  for (k = 0; k < n; k++) {
    derivatives(&grounds[slot], x[k], y[k], 0, d);
    height[k] = d[0][0];
  }
}

#ifdef _WIN32
API void *PyInit__kernel(void) { return NULL; } /* the linker is told to export it */
#endif
