/* Vectors of doubles, one lane per pose or motion, and the functions that CasADi's operations need.
 *
 * LANES is a number of doubles that fits a register of the machine. All operations are the same in
 * every lane: those of IEEE 754, in which products may be fused with sums (-ffp-contract=fast). No
 * reciprocals by approximation, never -ffast-math, which removes the rounding by a large constant
 * in `turned_sine`.
 *
 * Sines, cosines and arc tangents (within 2e-16) and exponentials (within 4e-16) are polynomials
 * of the Cephes library (S. Moshier): a loop over lanes that calls the mathematical library takes
 * up to ten times as long, since its wrappers are slow after wide registers were used.
 */
#include <math.h>
#include <string.h>

typedef double vd __attribute__((vector_size(8 * LANES), aligned(8)));
typedef long long vl __attribute__((vector_size(8 * LANES), aligned(8)));

/* The compiler does not fold a loop over lanes into a constant: SPLAT is defined by the caller. */
static inline vd splat(double a) { return (vd){0} + a; }

static inline vd pick(vl mask, vd a, vd b) { return (vd)((mask & (vl)a) | (~mask & (vl)b)); }
static inline vd truth(vl mask) { return (vd)(mask & (vl)SPLAT(1.0)); }
static inline vd lt(vd a, vd b) { return truth(a < b); }
static inline vd le(vd a, vd b) { return truth(a <= b); }
static inline vd eq(vd a, vd b) { return truth(a == b); }
static inline vd ne(vd a, vd b) { return truth(a != b); }
static inline vd not(vd a) { return truth(a == SPLAT(0.0)); }
static inline vd and(vd a, vd b) { return truth((a != SPLAT(0.0)) & (b != SPLAT(0.0))); }
static inline vd or(vd a, vd b) { return truth((a != SPLAT(0.0)) | (b != SPLAT(0.0))); }
/* Bits are selected, since a product with zero would keep an infinity of the other branch. */
static inline vd if_else_zero(vd a, vd b) { return (vd)((a != SPLAT(0.0)) & (vl)b); }
/* As in C, the other argument is the result if one is not a number. */
static inline vd vmin(vd a, vd b) { return pick((a < b) | (b != b), a, b); }
static inline vd vmax(vd a, vd b) { return pick((a > b) | (b != b), a, b); }
static inline vd vabs(vd a) { return (vd)((vl)a & ~(vl)SPLAT(-0.0)); }
static inline vd vcopysign(vd a, vd b) {
  vl sign = (vl)SPLAT(-0.0);
  return (vd)(((vl)a & ~sign) | ((vl)b & sign));
}
static inline vd vsign(vd a) { return pick(a == a, truth(a > SPLAT(0.0)) - truth(a < SPLAT(0.0)), a); }

#define EACH(name) \
  static inline vd v##name(vd a) { vd r; for (int i = 0; i < LANES; i++) r[i] = name(a[i]); return r; }
#define EACH2(name) \
  static inline vd v##name(vd a, vd b) { vd r; for (int i = 0; i < LANES; i++) r[i] = name(a[i], b[i]); return r; }
EACH(log) EACH(tan) EACH(asin) EACH(acos) EACH(sinh) EACH(cosh) EACH(tanh)
EACH(expm1) EACH(log1p) EACH2(pow) EACH2(fmod)

#if LANES == 8 && defined(__AVX512F__)
#include <immintrin.h>
static inline vd vsqrt(vd a) { return (vd)_mm512_sqrt_pd((__m512d)a); }
#elif LANES == 4 && defined(__AVX__)
#include <immintrin.h>
static inline vd vsqrt(vd a) { return (vd)_mm256_sqrt_pd((__m256d)a); }
#else
EACH(sqrt)
#endif
/* The sum with 1.5 * 2^52 is rounded to an integer; larger numbers are integers. */
#define TO_INTEGER SPLAT(6755399441055744.0)
static inline vd vfloor(vd a) {
  vd n = a + TO_INTEGER - TO_INTEGER;
  return pick(vabs(a) < SPLAT(2251799813685248.0), n - truth(n > a), a);
}
static inline vd vceil(vd a) { return -vfloor(-a); }
/* Zero where the result is below 1e-307, infinite above the largest number. */
static inline vd vexp(vd a) {
  vd t = a * SPLAT(1.44269504088896340736) + TO_INTEGER, n = t - TO_INTEGER;
  vd r = (a - n * SPLAT(6.93145751953125e-1)) - n * SPLAT(1.42860682030941723212e-6), z = r * r;
  vd p = r * ((SPLAT(1.26177193074810590878e-4) * z + SPLAT(3.02994407707441961300e-2)) * z + SPLAT(1.0));
  vd q = ((SPLAT(3.00198505138664455042e-6) * z + SPLAT(2.52448340349684104192e-3)) * z
         + SPLAT(2.27265548208155028766e-1)) * z + SPLAT(2.0);
  vd half = (vd)(((vl)t - (vl)TO_INTEGER + 1022) << 52); /* 2^(n - 1), since 2^1024 is infinite */
  vd result = (SPLAT(1.0) + SPLAT(2.0) * p / (q - p)) * half * SPLAT(2.0);
  return pick(a < SPLAT(-707.0), SPLAT(0.0), pick(a > SPLAT(709.78271289338397), SPLAT(INFINITY), result));
}
/* Without scaling: numbers are far from 1e154, whose squares overflow. */
static inline vd vhypot(vd a, vd b) { return vsqrt(a * a + b * b); }

/* Sine of a + quarter pi/2, for |a| < 1e6: pi/2 in three parts is subtracted, the quadrant decides. */
static inline vd turned_sine(vd a, long long quarter) {
  vd t = a * SPLAT(0.63661977236758134308) + TO_INTEGER, n = t - TO_INTEGER;
  vl quadrant = (vl)t + quarter;
  vd r = ((a - n * SPLAT(1.57079632673412561417e+00)) - n * SPLAT(6.07710050630396597660e-11))
         - n * SPLAT(2.02226624879595063154e-21);
  vd z = r * r;
  vd s = r + r * z * (((((SPLAT(1.58962301576546568060e-10) * z - SPLAT(2.50507477628578072866e-8)) * z
         + SPLAT(2.75573136213857245213e-6)) * z - SPLAT(1.98412698295895385996e-4)) * z
         + SPLAT(8.33333333332211858878e-3)) * z - SPLAT(1.66666666666666307295e-1));
  vd c = SPLAT(1.0) - SPLAT(0.5) * z + z * z * (((((SPLAT(-1.13585365213876817300e-11) * z
         + SPLAT(2.08757008419747316778e-9)) * z - SPLAT(2.75573141792967388112e-7)) * z
         + SPLAT(2.48015872888517045348e-5)) * z - SPLAT(1.38888888888730564116e-3)) * z
         + SPLAT(4.16666666666665929218e-2));
  vd v = pick((quadrant & 1) != 0, c, s);
  return (vd)((vl)v ^ ((quadrant & 2) << 62));
}
static inline vd vsin(vd a) { return turned_sine(a, 0); }
static inline vd vcos(vd a) { return turned_sine(a, 1); }

static inline vd vatan(vd a) {
  vl sign = (vl)a & (vl)SPLAT(-0.0);
  a = (vd)((vl)a ^ sign);
  vl far = a > SPLAT(2.41421356237309504880), middle = (a > SPLAT(0.66)) & ~far;
  vd start = pick(far, SPLAT(1.57079632679489661923), pick(middle, SPLAT(0.78539816339744830962), SPLAT(0.0)));
  vd rest = pick(far, SPLAT(6.123233995736765886130e-17), pick(middle, SPLAT(3.0616169978683829430e-17), SPLAT(0.0)));
  a = pick(far, SPLAT(-1.0) / a, pick(middle, (a - SPLAT(1.0)) / (a + SPLAT(1.0)), a));
  vd z = a * a;
  vd p = (((SPLAT(-8.750608600031904122785e-1) * z - SPLAT(1.615753718733365076637e1)) * z
         - SPLAT(7.500855792314704667340e1)) * z - SPLAT(1.228866684490136173410e2)) * z - SPLAT(6.485021904942025371773e1);
  vd q = ((((z + SPLAT(2.485846490142306297962e1)) * z + SPLAT(1.650270098316988542046e2)) * z
         + SPLAT(4.328810604912902668951e2)) * z + SPLAT(4.853903996359136964868e2)) * z + SPLAT(1.945506571482613964425e2);
  start = start + (a * (z * p / q) + a + rest);
  return (vd)((vl)start ^ sign);
}
static inline vd vatan2(vd y, vd x) {
  vl sign = (vl)y & (vl)SPLAT(-0.0), back = x < SPLAT(0.0);
  vd a = vatan(y / x), turn = (vd)((vl)SPLAT(3.14159265358979323846) | sign);
  vd result = pick(back, a + turn, a);
  result = pick(x == SPLAT(0.0), (vd)((vl)SPLAT(1.57079632679489661923) | sign), result);
  /* both zero: zero or half a turn, by the sign of x */
  return pick((x == SPLAT(0.0)) & (y == SPLAT(0.0)), pick(((vl)x & (vl)SPLAT(-0.0)) != 0, turn, y), result);
}

/* A spline ground: the cells of slipfree.core.lookups. */
typedef struct {
  const double *table; /* coefficients, y fastest */
  long long width;     /* of a row of the table */
  double x, y;         /* local coordinates of the node nearest to the local origin */
  double h_x, h_y;     /* distances between nodes */
  double first_i, first_j, last_i, last_j; /* indices of that node and of the last cell */
} Cells;

#define ON_KNOT 1e-10 /* a point nearer to a knot than this, in cells, lies on it */

/* The four B-splines, times six, and their derivatives in the middle of a cell, applied to four
 * coefficients: orders 0 to 3. They are even or odd, which halves the products. */
static inline void middle(const vd *c, vd *d) {
  vd outer = c[0] + c[3], inner = c[1] + c[2], wide = c[3] - c[0], narrow = c[2] - c[1];
  d[0] = SPLAT(0.125) * outer + SPLAT(2.875) * inner;
  d[1] = SPLAT(0.75) * wide + SPLAT(3.75) * narrow;
  d[2] = SPLAT(3.0) * (outer - inner);
  d[3] = SPLAT(6.0) * wide - SPLAT(18.0) * narrow;
}

/* Four numbers of a table from a place of each lane, as four vectors. Eight rows of four numbers are transposed in
 * registers: numbers that are stored one by one can be read as vectors only when they have left the processor. */
static inline void load_four(const double *table, vl place, vd *c) {
#if LANES == 8 && defined(__AVX512F__)
  __m512d pairs[4];
#pragma GCC unroll 4
  for (int k = 0; k < 4; k++) {
    const double *low = table + place[k + (k & 2)], *high = table + place[k + (k & 2) + 2];
    pairs[k] = _mm512_insertf64x4(_mm512_castpd256_pd512(_mm256_loadu_pd(low)), _mm256_loadu_pd(high), 1);
  }
  for (int k = 0; k < 2; k++) {
    __m512d a = k ? _mm512_unpackhi_pd(pairs[0], pairs[1]) : _mm512_unpacklo_pd(pairs[0], pairs[1]);
    __m512d b = k ? _mm512_unpackhi_pd(pairs[2], pairs[3]) : _mm512_unpacklo_pd(pairs[2], pairs[3]);
    c[k] = (vd)_mm512_shuffle_f64x2(a, b, 0x88);
    c[k + 2] = (vd)_mm512_shuffle_f64x2(a, b, 0xDD);
  }
#else
  for (int l = 0; l < LANES; l++)
    for (int n = 0; n < 4; n++) c[n][l] = table[place[l] + n];
#endif
}

/* The centre of the cell at a point and the 16 derivatives there, orders in x fastest. */
static void look(const Cells *g, vd x, vd y, vd *found) {
  vd c[4][4], in_x[4][4]; /* by y, then by x or by order in x */
  vd i = vmin(vmax(vfloor((x - splat(g->x)) / splat(g->h_x) + SPLAT(ON_KNOT)), splat(-g->first_i)), splat(g->last_i - g->first_i));
  vd j = vmin(vmax(vfloor((y - splat(g->y)) / splat(g->h_y) + SPLAT(ON_KNOT)), splat(-g->first_j)), splat(g->last_j - g->first_j));
  vd number = (i + splat(g->first_i)) * splat(g->width) + (j + splat(g->first_j));
  vl place = (vl)(number + TO_INTEGER) - (vl)TO_INTEGER;
  for (int m = 0; m < 4; m++) {
    vd row[4];
    load_four(g->table + m * g->width, place, row);
    for (int n = 0; n < 4; n++) c[n][m] = row[n];
  }
  found[0] = splat(g->x) + (i + SPLAT(0.5)) * splat(g->h_x);
  found[1] = splat(g->y) + (j + SPLAT(0.5)) * splat(g->h_y);
  double by_x = 1 / g->h_x, by_y = 1 / g->h_y;
  for (int n = 0; n < 4; n++) middle(c[n], in_x[n]);
  for (int m = 0; m < 4; m++) {
    vd line[4] = {in_x[0][m], in_x[1][m], in_x[2][m], in_x[3][m]}, d[4];
    double scale = m == 0 ? 1 : m == 1 ? by_x : m == 2 ? by_x * by_x : by_x * by_x * by_x;
    middle(line, d);
    for (int n = 0; n < 4; n++, scale *= by_y) found[2 + m + 4 * n] = splat(scale) * d[n];
  }
}

/* Lanes of a row; the last lane is repeated beyond the end. */
static inline vd load(const double *row, long n) {
  vd r;
  if (n >= LANES) { memcpy(&r, row, sizeof r); return r; }
  for (int l = 0; l < LANES; l++) r[l] = row[l < n ? l : n - 1];
  return r;
}
static inline void store(double *row, vd r, long n) {
  if (n >= LANES) memcpy(row, &r, sizeof r);
  else for (int l = 0; l < n; l++) row[l] = r[l];
}
