/* Bicubic spline grounds in plain C: the polynomial of the cell at a point, as CasADi calls external
 * functions. `kernel.py` opens grounds and says what the numbers mean; `bicubic.py` does the same
 * without a compiler, and is what this is tested against.
 *
 * Every ground that is open has a slot, whose function carries its number in its name: groundN,
 * from (x, y, key) to the middle of the cell and the 16 derivatives there, orders in x fastest.
 * CasADi counts its own uses of it (incref, decref); a slot in use is not given away. The key tells
 * grounds apart that have had the same slot: functions of another one, say from another process,
 * give no number instead of its heights.
 */
#include <math.h>
#include <stddef.h>

#ifdef _WIN32
#define API __declspec(dllexport)
#else
#define API __attribute__((visibility("default")))
#endif

#define SLOTS 64
#define LAYOUT 2 /* of the numbers below; kernel.py expects it */
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

/* fmin and fmax put NaN into a valid cell, whose polynomial then returns NaN. */
static double cell(double a, double first, double last) {
  return fmin(fmax(floor(a + ON_KNOT), -first), last - first);
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
static int refused(const Ground *g, const double **arg, double *res, int count) {
  if (g->table && arg[0] && arg[0][2] == g->key) return 0;
  while (count--) res[count] = NAN;
  return 1;
}

static int polynomial(const Ground *g, const double **arg, double *res) {
  double a, b, i, j, middle[4][4], line[4], scale_x = 1, scale;
  const double *c;
  int m, n, k;
  if (!res || refused(g, arg, res, 18)) return 0;
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

/* Sparsity in CasADi's layout: rows, columns, where columns begin, rows of the entries. */
static const casadi_int POINT[] = {3, 1, 0, 3, 0, 1, 2},
  FOUND[] = {18, 1, 0, 18, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15, 16, 17};

#define SLOT(N)                                                                                    \
  API casadi_int ground##N##_n_in(void) { return 1; }                                              \
  API casadi_int ground##N##_n_out(void) { return 1; }                                             \
  API const casadi_int *ground##N##_sparsity_in(casadi_int k) { return k ? NULL : POINT; }         \
  API const casadi_int *ground##N##_sparsity_out(casadi_int k) { return k ? NULL : FOUND; }        \
  API void ground##N##_incref(void) { grounds[N].uses++; }                                         \
  API void ground##N##_decref(void) { grounds[N].uses--; }                                         \
  API int ground##N(const double **arg, double **res, casadi_int *iw, double *w, int mem) {        \
    (void)iw, (void)w, (void)mem;                                                                  \
    return polynomial(&grounds[N], arg, res[0]);                                                   \
  }
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

/* Heights at n local points. */
API void kernel_heights(int slot, casadi_int n, const double *x, const double *y, double *heights) {
  casadi_int k;
  for (k = 0; k < n; k++) heights[k] = height(&grounds[slot], x[k], y[k]);
}

#ifdef _WIN32
API void *PyInit__kernel(void) { return NULL; } /* the linker is told to export it */
#endif
