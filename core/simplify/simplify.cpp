// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/simplify/simplify.h"

#include <chrono>
#include <string>

namespace spherule {

namespace {

constexpr double kMethodShare = 0.8;  // of the progress

class Stopwatch {
 public:
  double seconds() const { return std::chrono::duration<double>(std::chrono::steady_clock::now() - begin_).count(); }

 private:
  std::chrono::steady_clock::time_point begin_ = std::chrono::steady_clock::now();
};

Simplified run(const SphereModel& model, const SampledObject& object, const SimplifyMethod& method,
               const Context& context) {
  struct Visitor {
    const SphereModel& model;
    const SampledObject& object;
    const Context& context;
    Simplified result{};

    void operator()(const SphericityOptions& o) { result.order = cluster_by_sphericity(model, o, context); }
    void operator()(const SplittingOptions& o) { result.order = split_spheres(model, o, context); }
    void operator()(const PruneOptions& o) { result.order = prune_spheres(model, o, context); }
    void operator()(const BestOptions& o) {
      BestSpheres best = best_spheres(model, object, o, context);
      result.order = std::move(best.simplification);
      result.optimality_gap = best.optimality_gap;
    }
  } visitor{model, object, context};
  std::visit(visitor, method);
  return std::move(visitor.result);
}

}  // namespace

Simplified simplify(const SphereModel& model, const SampledObject& object, const Reference& reference,
                    const SimplifyMethod& method, const Context& context) {
  check_method(method, model.spheres.size());
  if (object.inside.count() == 0) {
    throw Error(ErrorCode::unusable, "The object has no samples to be compared with; choose a finer volume.");
  }
  Context part = context;
  part.progress = [&](std::string_view stage, double done) { context.report(stage, kMethodShare * done); };
  const Stopwatch watch;
  Simplified result = run(model, object, method, part);
  result.seconds = watch.seconds();
  part.progress = [&](std::string_view stage, double done) {
    context.report(stage, kMethodShare + (1 - kMethodShare) * done);
  };
  result.achieved = evaluate(spheres_at(result.order, result.order.last_level()), object, reference, part);
  result.evaluate_seconds = watch.seconds() - result.seconds;
  return result;
}

void check_method(const SimplifyMethod& method, std::size_t model_count) {
  std::visit([&](const auto& options) { check_options(options, model_count); }, method);
}

}  // namespace spherule
