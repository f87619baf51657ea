// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/simplify/sphericity.h"

#include <algorithm>
#include <numeric>
#include <queue>
#include <tuple>

#include "core/base/progress.h"
#include "core/simplify/ball_components.h"
#include "core/simplify/levels.h"

namespace spherule {

namespace {

// Rounding of an enclosing sphere may leave a cluster that passes by this much short of the threshold.
constexpr double kSlack = 1e-9;

// The smallest sphere around members, and those that touch it: it stays the smallest for any subset with these.
struct Enclosing {
  Sphere sphere;
  std::vector<std::uint32_t> touching;
};

Enclosing enclosing_of(std::span<const Sphere> balls, std::span<const std::uint32_t> members) {
  Enclosing result{represent(Representative::enclosing, balls, {}, members), {}};
  for (const std::uint32_t m : members) {
    const double reach = norm(balls[m].centre - result.sphere.centre) + balls[m].radius;
    if (reach >= result.sphere.radius * (1 - kSlack)) result.touching.push_back(m);
  }
  return result;
}

struct Cluster {
  std::vector<std::uint32_t> members;  // ascending
  std::uint32_t largest = 0;           // the first of the largest members
  Enclosing enclosing{};
  std::uint32_t node = 0;  // its sphere in the result
  bool connected = true;   // its union is known to be one component
  bool shattered = false;  // it has more components than there may be clusters
};

double sphericity_of(double largest, double enclosing) { return enclosing > 0 ? largest / enclosing : 1; }

std::uint32_t largest_of(std::span<const Sphere> balls, std::span<const std::uint32_t> members) {
  return *std::ranges::max_element(members, {}, [&](std::uint32_t m) { return balls[m].radius; });
}

class Clustering {
 public:
  Clustering(const SphereModel& model, const SphericityOptions& options, const Context& context)
      : balls_(model.spheres),
        options_(options),
        context_(context),
        shares_(options.representative == Representative::enclosing || options.representative == Representative::largest
                    ? std::vector<double>()
                    : volume_shares(model, quiet(context))),
        components_(model, context) {}

  Simplification run() {
    std::vector<std::uint32_t> all(balls_.size());
    std::iota(all.begin(), all.end(), 0U);
    add(std::move(all), false, no_parent, 1);
    while (!rough_.empty() && count() < options_.limit) {
      context_.throw_if_cancelled();
      context_.report("sphericity", static_cast<double>(count()) / options_.limit);
      const std::uint32_t least = std::get<1>(rough_.top());
      rough_.pop();
      split(least);
    }
    return finish();
  }

 private:
  // By sphericity, then the older one.
  using Entry = std::tuple<double, std::uint32_t>;

  std::uint32_t count() const { return static_cast<std::uint32_t>(clusters_.size()); }

  // Puts a cluster at `slot` (or a new one), with its sphere in the result.
  void put(std::uint32_t slot, Cluster cluster, std::uint32_t parent, std::uint32_t level) {
    cluster.node = static_cast<std::uint32_t>(result_.spheres.size());
    const Sphere shown = options_.representative == Representative::enclosing
                             ? cluster.enclosing.sphere
                             : represent(options_.representative, balls_, shares_, cluster.members);
    result_.spheres.push_back({.sphere = shown, .parent = parent, .from = level});
    const double round = sphericity_of(balls_[cluster.largest].radius, cluster.enclosing.sphere.radius);
    if (round < options_.threshold * (1 - kSlack)) rough_.emplace(round, slot);
    if (slot == count()) {
      clusters_.push_back(std::move(cluster));
    } else {
      clusters_[slot] = std::move(cluster);
    }
  }

  void add(std::vector<std::uint32_t> members, bool connected, std::uint32_t parent, std::uint32_t level) {
    Cluster cluster{.members = std::move(members), .connected = connected};
    cluster.largest = largest_of(balls_, cluster.members);
    cluster.enclosing = enclosing_of(balls_, cluster.members);
    put(count(), std::move(cluster), parent, level);
  }

  // The members within the sphere about the largest one that just passes the threshold, and the others.
  struct Halves {
    std::vector<std::uint32_t> round, rest;
    std::uint32_t largest_of_rest = 0;
  };
  Halves halve(const Cluster& cluster) const {
    const Sphere& seed = balls_[cluster.largest];
    const double reach = seed.radius / options_.threshold;
    Halves halves;
    halves.rest.reserve(cluster.members.size());
    double most = -1;
    for (const std::uint32_t m : cluster.members) {
      const double room = reach - balls_[m].radius;
      if (squared_norm(balls_[m].centre - seed.centre) <= room * room && room >= 0) {
        halves.round.push_back(m);
      } else {
        halves.rest.push_back(m);
        if (balls_[m].radius > most) most = balls_[m].radius, halves.largest_of_rest = m;
      }
    }
    return halves;
  }

  // The components of what is left in the group, the largest first, without the main one.
  std::vector<std::vector<std::uint32_t>> other_components(const Cluster& cluster, std::uint32_t group,
                                                           std::span<const std::uint32_t> rest,
                                                           std::span<const std::uint32_t> taken) {
    auto parts =
        components_.parts_beside_main(group, rest, cluster.connected ? taken : std::span<const std::uint32_t>());
    for (auto& part : parts) std::ranges::sort(part);
    std::ranges::sort(parts, [](const auto& a, const auto& b) {
      return a.size() != b.size() ? a.size() > b.size() : a.front() < b.front();
    });
    return parts;
  }

  void split(std::uint32_t slot) {
    Halves halves = halve(clusters_[slot]);
    if (halves.rest.empty()) return;
    const Cluster cluster = std::move(clusters_[slot]);
    for (const std::uint32_t m : halves.round) components_.move(m, count());
    std::vector<std::vector<std::uint32_t>> parts;
    bool shattered = cluster.shattered;
    if (!shattered) {
      parts = other_components(cluster, slot, halves.rest, halves.round);
      shattered = parts.size() >= options_.limit - count();
      if (shattered) parts.clear();
    }
    const std::uint32_t level = count() + 1 + static_cast<std::uint32_t>(parts.size());
    result_.spheres[cluster.node].to = level - 1;
    add(std::move(halves.round), false, cluster.node, level);
    for (auto& part : parts) {
      for (const std::uint32_t m : part) components_.move(m, count());
      add(std::move(part), true, cluster.node, level);
    }

    const auto stays = [&](std::uint32_t m) { return components_.group_of(m) == slot; };
    Cluster main{.members = std::move(halves.rest),
                 .largest = halves.largest_of_rest,
                 .connected = !shattered,
                 .shattered = shattered};
    if (!parts.empty()) {
      std::erase_if(main.members, [&](std::uint32_t m) { return !stays(m); });
      main.largest = largest_of(balls_, main.members);
    }
    main.enclosing =
        std::ranges::all_of(cluster.enclosing.touching, stays) ? cluster.enclosing : enclosing_of(balls_, main.members);
    put(slot, std::move(main), cluster.node, level);
  }

  Simplification finish() {
    detail::LeafMembers leaves;
    for (Cluster& cluster : clusters_) {
      result_.spheres[cluster.node].to = count();
      leaves.emplace_back(cluster.node, cluster.members);
    }
    detail::set_members(result_, leaves);
    context_.report("sphericity", 1);
    return std::move(result_);
  }

  std::span<const Sphere> balls_;
  const SphericityOptions& options_;
  const Context& context_;
  std::vector<double> shares_;
  detail::BallComponents components_;  // a cluster's slot is its group there
  std::vector<Cluster> clusters_;
  std::priority_queue<Entry, std::vector<Entry>, std::greater<>> rough_;
  Simplification result_;
};

}  // namespace

double sphericity(std::span<const Sphere> balls, std::span<const std::uint32_t> members) {
  return sphericity_of(balls[largest_of(balls, members)].radius,
                       represent(Representative::enclosing, balls, {}, members).radius);
}

void check_options(const SphericityOptions& options, std::size_t model_count) {
  if (!(options.threshold > 0 && options.threshold <= 1)) {
    const char* sentence = "Give the sphericity threshold as a number above 0 and at most 1.";
    throw Error(ErrorCode::invalid_argument, sentence, {{"/threshold", sentence}});
  }
  detail::require_k(options.limit, model_count, "limit");
}

Simplification cluster_by_sphericity(const SphereModel& model, const SphericityOptions& options,
                                     const Context& context) {
  check_options(options, model.spheres.size());
  return Clustering(model, options, context).run();
}

}  // namespace spherule
