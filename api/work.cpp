// SPDX-License-Identifier: GPL-3.0-or-later
#include "api/work.h"

#include <type_traits>

namespace spherule::api {

namespace {

constexpr int kPictureEdition = 8;
// Of tables of spheres: 2 has float64 wherever numbers are binary.
constexpr int kTableEdition = 3;
constexpr int kFileEdition = 3;
constexpr int kMeasuresEdition = 5;
// Of what is derived from a registration.
constexpr int kAnswerEdition = 5;

constexpr Kind kModel{.name = "model", .record = "model", .source = {}, .edition = 0};
constexpr Kind kSimplification{
    .name = "simplification", .record = "simplification", .source = {}, .edition = simplify_edition};
constexpr Kind kRegistration{
    .name = "registration", .record = "registration", .source = {}, .edition = registration_edition};

constexpr auto kDerived = std::to_array<Kind>({
    {"measures", "measures", "model", kMeasuresEdition},
    {"checks", "checks", "model"},
    {"render", "render", "model", kPictureEdition},
    {"export", "export", "model", kTableEdition},
    {"contributions", "contributions", "model"},
    {"tree", "tree", "model"},
    {"export", "file", "model", kFileEdition},
    {"slice", "slice", "volume", kPictureEdition},
    {"histogram", "histogram", "volume"},
    {"registration_answer", "render", "registration", kAnswerEdition},
    {"registration_answer", "apply", "registration", kAnswerEdition},
});
static_assert(kDerived.size() == std::variant_size_v<decltype(DerivedRequest::what)>);

}  // namespace

const Kind& kind_of(const WorkRequest& request) {
  struct Visitor {
    const Kind& operator()(const ModelRequest&) const { return kModel; }
    const Kind& operator()(const SimplificationRequest&) const { return kSimplification; }
    const Kind& operator()(const RegistrationRequest&) const { return kRegistration; }
    const Kind& operator()(const DerivedRequest& derived) const { return kDerived[derived.what.index()]; }
  };
  return std::visit(Visitor{}, request);
}

std::vector<std::string> inputs_of(const WorkRequest& request) {
  struct Visitor {
    using Ids = std::vector<std::string>;
    static Ids both(const std::string& one, const std::string& other) {
      return other.empty() || other == one ? Ids{one} : Ids{one, other};
    }
    Ids operator()(const ModelRequest& model) const { return {model.volume}; }
    Ids operator()(const SimplificationRequest& simplification) const { return {simplification.model}; }
    Ids operator()(const RegistrationRequest& pair) const { return both(pair.fixed, pair.moving); }
    Ids operator()(const DerivedRequest& derived) const {
      const auto* render = std::get_if<RenderRequest>(&derived.what);
      return both(derived.source, render == nullptr ? std::string() : render->with);
    }
  };
  return std::visit(Visitor{}, request);
}

std::string_view name(SphereFormat format) {
  constexpr std::array<std::string_view, 4> names = {"csv", "npy", "ply", "vtp"};
  return names[static_cast<std::size_t>(format)];
}

std::string_view name(SphereFigure figure) {
  constexpr std::array<std::string_view, sphere_figures.size()> names = {
      "index", "volume_mm3", "area_mm2",   "share",    "rank",    "cumulative_share",
      "node",  "parent",     "level_from", "level_to", "members", "cluster"};
  return names[static_cast<std::size_t>(figure)];
}

std::string_view name(SphereRows rows) {
  constexpr std::array<std::string_view, 3> names = {"spheres", "nodes", "members"};
  return names[static_cast<std::size_t>(rows)];
}

std::string_view name(SphereOrder order) { return order == SphereOrder::index ? "index" : "contribution"; }

std::string_view name(Applied what) { return what == Applied::volume ? "volume" : "model"; }

std::string_view name(FigureFormat format) {
  constexpr std::array<std::string_view, 3> names = {"json", "png", "svg"};
  return names[static_cast<std::size_t>(format)];
}

std::string_view media_type(FigureFormat format) {
  constexpr std::array<std::string_view, 3> types = {"application/json", "image/png", "image/svg+xml"};
  return types[static_cast<std::size_t>(format)];
}

}  // namespace spherule::api
