// The problem of benchmarks/network_speed.py for Ceres: lengths l = s |x - x0| - l0 of points from tracers.
//
//   network_ceres PROBLEM MODE SOLVER TOLERANCE      MODE: auto, analytic, pairs   SOLVER: solve, covariance
//
// auto: derivatives by Ceres' jets, a residual for each length. analytic: derivatives written out, sizes known to the
// compiler (1; 5, 3). pairs: two lengths of a point in one residual (2; 5, 5, 3), for which Ceres has a Schur eliminator
// compiled with static sizes (2, 3, dynamic); there is none for rows of 1. A single length is left where m is odd.
// Points are eliminated first (DENSE_SCHUR); the radius lets the first step be a full Gauss-Newton step.
// The frame is held by six stiff conditions on three points, exact at the solution.
#include <ceres/ceres.h>
#include <sys/resource.h>
#include <unistd.h>

#include <cmath>
#include <cstdio>
#include <ctime>
#include <string>
#include <vector>

struct Reading {
  double length, root_weight;
};

static bool length_of(const Reading& r, const double* t, const double* x, double* residual, double* by_t,
                      double* by_x) {
  const double dx = x[0] - t[0], dy = x[1] - t[1], dz = x[2] - t[2], d = std::sqrt(dx * dx + dy * dy + dz * dz);
  *residual = r.root_weight * (t[4] * d - r.length - t[3]);
  const double f = r.root_weight * t[4] / d;
  if (by_x) by_x[0] = f * dx, by_x[1] = f * dy, by_x[2] = f * dz;
  if (by_t) by_t[0] = -f * dx, by_t[1] = -f * dy, by_t[2] = -f * dz, by_t[3] = -r.root_weight, by_t[4] = r.root_weight * d;
  return true;
}

struct Auto {
  Reading r;
  template <class T>
  bool operator()(const T* t, const T* x, T* residual) const {
    const T dx = x[0] - t[0], dy = x[1] - t[1], dz = x[2] - t[2];
    residual[0] = r.root_weight * (t[4] * sqrt(dx * dx + dy * dy + dz * dz) - r.length - t[3]);
    return true;
  }
};

struct One : ceres::SizedCostFunction<1, 5, 3> {
  Reading r;
  explicit One(Reading r) : r(r) {}
  bool Evaluate(double const* const* p, double* residual, double** j) const override {
    return length_of(r, p[0], p[1], residual, j ? j[0] : nullptr, j ? j[1] : nullptr);
  }
};

struct Pair : ceres::SizedCostFunction<2, 5, 5, 3> {
  Reading a, b;
  Pair(Reading a, Reading b) : a(a), b(b) {}
  bool Evaluate(double const* const* p, double* residual, double** j) const override {
    double* x = j ? j[2] : nullptr;
    double *first = j ? j[0] : nullptr, *second = j ? j[1] : nullptr;
    if (first)
      for (int k = 5; k < 10; k++) first[k] = 0.0;
    if (second)
      for (int k = 0; k < 5; k++) second[k] = 0.0;
    return length_of(a, p[0], p[2], residual, first, x) &&
           length_of(b, p[1], p[2], residual + 1, second ? second + 5 : nullptr, x ? x + 3 : nullptr);
  }
};

struct Scale : ceres::SizedCostFunction<1, 5> {
  double u;
  explicit Scale(double u) : u(u) {}
  bool Evaluate(double const* const* p, double* residual, double** j) const override {
    *residual = (p[0][4] - 1.0) / u;
    if (j && j[0]) j[0][0] = j[0][1] = j[0][2] = j[0][3] = 0.0, j[0][4] = 1.0 / u;
    return true;
  }
};

struct Held : ceres::SizedCostFunction<1, 3> {
  double at[3], along[3];
  Held(const double* x, const double* d) {
    for (int k = 0; k < 3; k++) at[k] = x[k], along[k] = 1e3 * d[k];
  }
  bool Evaluate(double const* const* p, double* residual, double** j) const override {
    *residual = 0.0;
    for (int k = 0; k < 3; k++) *residual += along[k] * (p[0][k] - at[k]);
    if (j && j[0])
      for (int k = 0; k < 3; k++) j[0][k] = along[k];
    return true;
  }
};

static double seconds() { return double(std::clock()) / CLOCKS_PER_SEC; }

int main(int argc, char** argv) {
  if (argc < 5) return 2;
  google::InitGoogleLogging(argv[0]);
  FILE* f = fopen(argv[1], "rb");
  long long mn[2];
  double u;
  if (!f || fread(mn, 8, 2, f) != 2 || fread(&u, 8, 1, f) != 1) return 3;
  const long m = mn[0], n = mn[1];
  auto read = [&](size_t count) {
    std::vector<double> values(count);
    if (fread(values.data(), 8, count, f) != count) exit(3);
    return values;
  };
  auto length = read(n * m), weight = read(n * m), x = read(3 * n), t = read(5 * m), conditions = read(6 * 4);
  fclose(f);
  const std::string mode = argv[2];
  const double started = seconds();
  ceres::Problem problem;
  auto reading = [&](long i, long j) { return Reading{length[i * m + j], weight[i * m + j]}; };
  for (long i = 0; i < n; i++) {
    long j = 0;
    if (mode == "pairs")
      for (; j + 1 < m; j += 2)
        problem.AddResidualBlock(new Pair(reading(i, j), reading(i, j + 1)), nullptr, &t[5 * j], &t[5 * j + 5], &x[3 * i]);
    for (; j < m; j++) {
      ceres::CostFunction* cost;
      if (mode == "auto")
        cost = new ceres::AutoDiffCostFunction<Auto, 1, 5, 3>(new Auto{reading(i, j)});
      else
        cost = new One(reading(i, j));
      problem.AddResidualBlock(cost, nullptr, &t[5 * j], &x[3 * i]);
    }
  }
  for (long j = 0; j < m; j++) problem.AddResidualBlock(new Scale(u), nullptr, &t[5 * j]);
  for (int k = 0; k < 6; k++) {
    double* point = &x[3 * long(conditions[4 * k])];
    problem.AddResidualBlock(new Held(point, &conditions[4 * k + 1]), nullptr, point);
  }
  auto order = std::make_shared<ceres::ParameterBlockOrdering>();
  for (long i = 0; i < n; i++) order->AddElementToGroup(&x[3 * i], 0);
  for (long j = 0; j < m; j++) order->AddElementToGroup(&t[5 * j], 1);
  ceres::Solver::Options options;
  options.linear_solver_ordering = order;
  options.linear_solver_type = ceres::DENSE_SCHUR;
  options.num_threads = 1;
  options.max_num_iterations = 100;
  options.initial_trust_region_radius = 1e16;
  options.max_trust_region_radius = 1e32;
  options.function_tolerance = options.parameter_tolerance = options.gradient_tolerance = std::stod(argv[4]);
  const double built = seconds();
  ceres::Solver::Summary summary;
  ceres::Solve(options, &problem, &summary);
  const double solved = seconds();
  double covered = 0.0;
  if (std::string(argv[3]) == "covariance") {
    ceres::Covariance::Options wanted;
    wanted.algorithm_type = ceres::SPARSE_QR;
    ceres::Covariance covariance(wanted);
    std::vector<std::pair<const double*, const double*>> blocks;
    for (long i = 0; i < n; i++) blocks.push_back({&x[3 * i], &x[3 * i]});
    if (!covariance.Compute(blocks, &problem)) return 4;
    covered = seconds() - solved;
  }
  struct rusage usage;
  getrusage(RUSAGE_SELF, &usage);
  printf("{\"build\": %.4f, \"solve\": %.4f, \"covariance\": %.4f, \"steps\": %d, \"cost\": %.12e, \"peak\": %.0f, \"x\": [%.12f, %.12f, %.12f]}\n",
         built - started, solved - built, covered, summary.num_successful_steps + summary.num_unsuccessful_steps,
         2 * summary.final_cost, usage.ru_maxrss / 1024.0, x[0], x[1], x[2]);
  fflush(stdout);
  _exit(0);
}
