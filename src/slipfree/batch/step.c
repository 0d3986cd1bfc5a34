/* Steps of Ralston's third-order method, as `advance` of motion.py does them without a compiler.
 * The macros are rows of the states and of the results of the graph "motion".
 *
 * `rates` are the derivatives at the states. After `counts` steps of length `h`, the positions are
 * predicted, not yet corrected. The last row of `out` is 1 for lanes whose corrections stayed small.
 */
static void moved(vd *s, const vd *start, const vd *k, vd h) {
  for (int i = 0; i < MOVING; i++) s[i] = start[i] + h * k[i];
}

static vl corrected(vd *s, const vd *r, double most, double worst) {
  for (int i = 0; i < POSITIONS; i++) s[FIRST_POSITION + i] = r[NEW_POSITIONS + i];
  for (int i = 0; i < UNKNOWNS; i++) s[FIRST_UNKNOWN + i] = r[NEW_UNKNOWNS + i];
  return (r[CHANGE] < splat(most)) & (r[ERROR] <= splat(worst));
}

void advance(long n, const double *in, long stride, const double *rates, const double *lengths,
             const double *counts, double most, double worst, double *out, const double *K, const Cells *cells) {
  vd a[ROWS], s[ROWS], r[RESULTS], k1[MOVING], k2[MOVING];
  for (long g = 0; g < n; g += LANES) {
    vd h = load(lengths + g, n - g);
    vl good = ~(vl)SPLAT(0.0);
    for (int i = 0; i < ROWS; i++) a[i] = load(in + i * stride + g, n - g);
    for (int i = 0; i < MOVING; i++) k1[i] = load(rates + i * n + g, n - g);
    vd count = load(counts + g, n - g);
    double steps = count[0];
    for (int l = 1; l < LANES; l++) steps = fmax(steps, count[l]);
    for (double step = 0; step < steps; step++) {
      vl done = count <= splat(step);
      memcpy(s, a, sizeof s);
      if (step) {
        eval_motion(s, r, K, cells, 1.0);
        good &= corrected(s, r, most, worst) | done;
        memcpy(k1, r, sizeof k1);
        for (int i = 0; i < ROWS; i++) a[i] = pick(done, a[i], s[i]);
      }
      moved(s, a, k1, SPLAT(0.5) * h);
      s[TIME] = a[TIME] + SPLAT(0.5) * h;
      eval_motion(s, r, K, cells, 1.0);
      good &= corrected(s, r, most, worst) | done;
      memcpy(k2, r, sizeof k2);
      moved(s, a, k2, SPLAT(0.75) * h);
      s[TIME] = a[TIME] + SPLAT(0.75) * h;
      eval_motion(s, r, K, cells, 1.0);
      good &= corrected(s, r, most, worst) | done;
      for (int i = 0; i < MOVING; i++)
        s[i] = a[i] + (h / SPLAT(9.0)) * (SPLAT(2.0) * k1[i] + SPLAT(3.0) * k2[i] + SPLAT(4.0) * r[i]);
      s[TIME] = a[TIME] + h;
      for (int i = 0; i < ROWS; i++) a[i] = pick(done, a[i], s[i]);
    }
    for (int i = 0; i < ROWS; i++) store(out + i * n + g, a[i], n - g);
    store(out + ROWS * n + g, truth(good), n - g);
  }
}
