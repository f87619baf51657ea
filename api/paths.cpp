// SPDX-License-Identifier: GPL-3.0-or-later
#include "api/paths.h"

#include <algorithm>

#include "core/base/text.h"
#include "core/render/options.h"

namespace spherule::api {

namespace {

std::string query_of(const RenderRequest& request) {
  OptionTexts texts = render_option_texts(request.options);
  const OptionTexts usual = render_option_texts({});
  std::erase_if(texts, [&](const auto& text) { return std::ranges::find(usual, text) != usual.end(); });
  if (!request.with.empty()) texts.emplace_back("with", request.with);
  std::string query;
  for (const auto& [name, text] : texts) query += (query.empty() ? "?" : "&") + name + "=" + text;
  return query;
}

std::string query_of(const SliceRequest& request) {
  OptionTexts texts{{"format", std::string(name(request.format))}};
  if (request.object) {
    const ObjectRule& rule = *request.object;
    switch (rule.kind) {
      case ObjectRule::Kind::threshold: texts.emplace_back("threshold", text_of(rule.lo)); break;
      case ObjectRule::Kind::range: texts.emplace_back("range", text_of(rule.lo) + "," + text_of(rule.hi)); break;
      case ObjectRule::Kind::labels: {
        std::string list;
        for (const Label label : rule.labels) list += (list.empty() ? "" : ",") + to_text(label);
        texts.emplace_back("labels", list);
        break;
      }
    }
    texts.emplace_back("inside", rule.side == Side::above ? "above" : "below");
    if (rule.border == Border::open) texts.emplace_back("border", "open");
  }
  const OptionTexts usual = slice_option_texts({});
  for (const auto& text : slice_option_texts(request.options))
    if (std::ranges::find(usual, text) == usual.end()) texts.push_back(text);
  std::string query;
  for (const auto& [name, text] : texts) query += (query.empty() ? "?" : "&") + name + "=" + text;
  return query;
}

std::string query_of(const FileRequest& request) {
  std::string query;
  for (const auto& [name, text] : file_option_texts(request.format, request.options)) {
    query += (query.empty() ? "?" : "&") + name + "=" + text;
  }
  return query;
}

std::string query_of(const BeforeAfterRequest& request) {
  RenderOptions options = request.options;
  options.layout = Layout::beside;
  std::string query = query_of(RenderRequest{.options = options, .with = {}});
  if (request.few) query += query.empty() ? "?of=spheres" : "&of=spheres";
  return query;
}

// What follows the source's path, before the level.
struct Path {
  std::string operator()(const MeasuresRequest&) const { return "/measures"; }
  std::string operator()(const ChecksRequest&) const { return "/checks"; }
  std::string operator()(const RenderRequest& r) const { return "/render" + query_of(r); }
  std::string operator()(const ExportRequest& e) const {
    std::string path = "/exports/" + std::string(name(e.format));
    char before = '?';
    for (const SphereFigure figure : e.listing.columns) {
      path += (before == '?' ? "?columns=" : ",") + std::string(name(figure));
      before = '&';
    }
    if (e.listing.order != SphereOrder::index) {
      path += before + ("order=" + std::string(name(e.listing.order)));
      before = '&';
    }
    if (e.listing.rows != SphereRows::spheres) path += before + ("rows=" + std::string(name(e.listing.rows)));
    return path;
  }
  std::string operator()(const FileRequest& f) const {
    return "/exports/" + std::string(info(f.format).name) + query_of(f);
  }
  std::string operator()(const ContributionsRequest&) const { return "/spheres?order=contribution"; }
  std::string operator()(const TreeRequest& t) const {
    std::string path = "/tree";
    for (std::size_t i = 0; i < t.levels.size(); ++i) {
      path += (i == 0 ? "?levels=" : ",") + std::to_string(t.levels[i]);
    }
    return path;
  }
  std::string operator()(const SliceRequest& s) const {
    return std::string("/slices/") + "ijk"[s.axis] + "/" + std::to_string(s.index) + query_of(s);
  }
  std::string operator()(const ValuesRequest& v) const { return "/histogram?buckets=" + std::to_string(v.buckets); }
  std::string operator()(const BeforeAfterRequest& b) const { return "/render" + query_of(b); }
  std::string operator()(const AppliedRequest& a) const { return "/apply?what=" + std::string(name(a.what)); }
};

}  // namespace

std::string path_of(const WorkRequest& request, const std::string& result_id) {
  const auto* derived = std::get_if<DerivedRequest>(&request);
  if (derived == nullptr)
    return (std::holds_alternative<RegistrationRequest>(request) ? "/v1/registrations/" : "/v1/models/") + result_id;
  std::string path = "/v1/" + std::string(kind_of(request).source) + "s/" + derived->source;
  path += std::visit(Path{}, derived->what);
  if (derived->level > 0)
    path += (path.find('?') == path.npos ? "?level=" : "&level=") + std::to_string(derived->level);
  return path;
}

}  // namespace spherule::api
