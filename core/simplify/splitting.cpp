// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/simplify/splitting.h"

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <functional>
#include <numeric>
#include <queue>
#include <utility>

#include "core/base/poll.h"
#include "core/base/progress.h"
#include "core/simplify/levels.h"

namespace spherule {

namespace {

// A range of the permutation of all spheres.
struct Cluster {
  std::uint32_t begin = 0, end = 0;
  std::uint32_t node = 0;  // its sphere in the result
  Vec3 mean{}, axis{};
  double variance = 0;  // of the centres along `axis`, the direction of the largest
};

struct Widest {
  bool operator()(const Cluster& a, const Cluster& b) const {
    return std::pair(a.variance, -static_cast<std::int64_t>(a.node)) <
           std::pair(b.variance, -static_cast<std::int64_t>(b.node));
  }
};

void find_axis(Cluster& cluster, std::span<const Sphere> balls, std::span<const std::uint32_t> members, Poll& poll) {
  // Measured from one member, so that an object far from the origin loses no digits.
  const Vec3 origin = balls[members[0]].centre;
  Vec3 sum;
  double xx = 0, xy = 0, xz = 0, yy = 0, yz = 0, zz = 0;
  for (const std::uint32_t m : members) {
    poll(2);
    const Vec3 p = balls[m].centre - origin;
    sum = sum + p;
    xx += p.x * p.x, xy += p.x * p.y, xz += p.x * p.z, yy += p.y * p.y, yz += p.y * p.z, zz += p.z * p.z;
  }
  const double n = static_cast<double>(members.size());
  const Vec3 mean = (1 / n) * sum;
  cluster.mean = origin + mean;
  Eigen::Matrix3d covariance;
  covariance << xx / n - mean.x * mean.x, xy / n - mean.x * mean.y, xz / n - mean.x * mean.z, xy / n - mean.x * mean.y,
      yy / n - mean.y * mean.y, yz / n - mean.y * mean.z, xz / n - mean.x * mean.z, yz / n - mean.y * mean.z,
      zz / n - mean.z * mean.z;
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> solver(covariance);
  const auto axis = solver.eigenvectors().col(2);
  cluster.axis = {axis(0), axis(1), axis(2)};
  cluster.variance = members.size() > 1 ? std::max(solver.eigenvalues()(2), 0.0) : -1;  // one sphere cannot be split
}

}  // namespace

void check_options(const SplittingOptions& options, std::size_t model_count) {
  detail::require_k(options.k, model_count);
}

Simplification split_spheres(const SphereModel& model, const SplittingOptions& options, const Context& context) {
  const std::span<const Sphere> balls = model.spheres;
  check_options(options, balls.size());
  const std::vector<double> shares = volume_shares(model, quiet(context));
  std::vector<std::uint32_t> order(balls.size());
  std::iota(order.begin(), order.end(), 0U);

  Simplification result;
  Poll poll(context);
  std::priority_queue<Cluster, std::vector<Cluster>, Widest> clusters;
  const auto add = [&](std::uint32_t begin, std::uint32_t end, std::uint32_t parent, std::uint32_t level) {
    const auto members = std::span<const std::uint32_t>(order).subspan(begin, end - begin);
    Cluster cluster{.begin = begin, .end = end, .node = static_cast<std::uint32_t>(result.spheres.size())};
    find_axis(cluster, balls, members, poll);
    result.spheres.push_back(
        {.sphere = represent(options.representative, balls, shares, members), .parent = parent, .from = level});
    clusters.push(cluster);
  };
  add(0, static_cast<std::uint32_t>(balls.size()), no_parent, 1);

  std::vector<std::pair<double, std::uint32_t>> keys;  // along the axis, from the mean; then the index, for ties
  for (std::uint32_t count = 1; count < options.k; ++count) {
    if (count % 16 == 1) context.report("splitting", static_cast<double>(count) / options.k);
    const Cluster widest = clusters.top();
    clusters.pop();
    result.spheres[widest.node].to = count;
    keys.clear();
    for (std::uint32_t p = widest.begin; p < widest.end; ++p) {
      poll(4);
      keys.emplace_back(dot(balls[order[p]].centre - widest.mean, widest.axis), order[p]);
    }
    auto middle = keys.begin();
    if (options.at == SplittingOptions::At::average) {
      middle = std::partition(keys.begin(), keys.end(), [](const auto& key) { return key.first < 0; });
    }
    if (middle == keys.begin() || middle == keys.end()) {
      middle = keys.begin() + static_cast<std::ptrdiff_t>(keys.size() / 2);
      std::nth_element(keys.begin(), middle, keys.end(), Polled(poll, std::less<>()));
    }
    for (std::size_t i = 0; i < keys.size(); ++i) order[widest.begin + i] = keys[i].second;
    const auto cut = widest.begin + static_cast<std::uint32_t>(middle - keys.begin());
    add(widest.begin, cut, widest.node, count + 1);
    add(cut, widest.end, widest.node, count + 1);
  }

  detail::LeafMembers leaves;
  for (; !clusters.empty(); clusters.pop()) {
    const Cluster& cluster = clusters.top();
    result.spheres[cluster.node].to = options.k;
    leaves.emplace_back(cluster.node, std::span(order).subspan(cluster.begin, cluster.end - cluster.begin));
  }
  detail::set_members(result, leaves);
  context.report("splitting", 1);
  return result;
}

}  // namespace spherule
