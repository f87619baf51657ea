// SPDX-License-Identifier: GPL-3.0-or-later
//
// Health, versions, and the contract with a page that shows it.
#include <array>

#include "api/handlers/handlers.h"
#include "api/handlers/parameters.h"
#include "api/http/negotiation.h"
#include "api/http/query.h"
#include "api/json/documents.h"
#include "api/routes.h"

namespace spherule::api {

namespace {

std::string escaped(std::string_view text) {
  std::string out;
  for (const char c : text) {
    switch (c) {
      case '&': out += "&amp;"; break;
      case '<': out += "&lt;"; break;
      case '>': out += "&gt;"; break;
      case '"': out += "&quot;"; break;
      default: out += c;
    }
  }
  return out;
}

constexpr std::string_view kHead = R"(<!doctype html>
<html lang="en"><head><meta charset="utf-8"><title>Spherule: the interface</title>
<meta name="viewport" content="width=device-width, initial-scale=1"><style>
body { font: 16px/1.5 system-ui, sans-serif; max-width: 60rem; margin: 2rem auto; padding: 0 1rem; color: #222; background: #fff }
details { border: 1px solid #ccc; border-radius: 6px; margin: .4rem 0; padding: .3rem .8rem }
summary { cursor: pointer } summary code { font-weight: 600 } b { display: inline-block; width: 5rem; font-family: monospace }
.get { color: #05648c } .post { color: #1d6f2b } .patch { color: #8a5a00 } .delete { color: #a02020 }
pre { overflow-x: auto; font-size: 13px; line-height: 1.4; background: #f5f5f3; padding: .8rem; border-radius: 6px }
</style></head><body><h1>Spherule: the interface</h1>
<p>Volumetric scans in, union-of-spheres models out. This page shows <a href="/openapi.yaml">/openapi.yaml</a> (OpenAPI 3.1),
one entry an operation; the whole text is at the end.</p>
)";

// The lines of `text` that are indented deeper than `indent` spaces, from the start on.
std::string_view block(std::string_view text, std::size_t indent) {
  std::size_t end = 0;
  while (end < text.size()) {
    const std::size_t first = text.find_first_not_of(' ', end);
    if (first == std::string_view::npos) return text;
    if (text[first] != '\n' && first - end <= indent) break;
    end = std::min(text.find('\n', first), text.size() - 1) + 1;
  }
  return text.substr(0, end);
}

// What follows the line `key` (with its line break), or nothing.
std::string_view after(std::string_view text, const std::string& line) {
  const std::size_t at = text.find(line);
  return at == std::string_view::npos ? std::string_view{} : text.substr(at + line.size());
}

std::string docs_page() {
  std::string page(kHead);
  for (const Operation& operation : operations()) {
    std::string method(operation.method);
    for (char& c : method) c = static_cast<char>(c + 32);
    const std::string_view path = block(after(contract(), "\n  " + std::string(operation.path) + ":\n"), 2);
    const std::string_view body = block(after(path, "    " + method + ":\n"), 4);
    std::string_view summary = after(body, "      summary: ");
    summary = summary.substr(0, summary.find('\n'));
    page += "<details><summary><b class=\"" + method + "\">" + std::string(operation.method) + "</b><code>" +
            escaped(operation.path) + "</code> " + escaped(summary) + "</summary><pre>" + escaped(body) +
            "</pre></details>\n";
  }
  page += "<h2>openapi.yaml</h2><pre>" + escaped(contract()) + "</pre></body></html>\n";
  return page;
}

Response text_response(const Call& call, std::string_view type, std::string text) {
  negotiate(call.request.header("Accept"), std::span(&type, 1));
  Response response{.status = 200, .body = std::move(text)};
  response.set("Content-Type", std::string(type) + "; charset=utf-8");
  return response;
}

}  // namespace

Response get_livez(const Call& call) { return json_response(call, status_document("alive")); }

Response get_readyz(const Call& call) {
  const Readiness readiness = call.service.readiness();
  if (!readiness.ready) throw Error(ErrorCode::busy, readiness.reason);
  return json_response(call, status_document("ready"));
}

Response get_version(const Call& call) { return json_response(call, about_document(call.service.about())); }

Response get_contract(const Call& call) {
  // Served to whatever asks: there is no registered type that all YAML tools send.
  const Query query(call.request, {});
  Response response{.status = 200, .body = std::string(contract())};
  response.set("Content-Type", "application/yaml; charset=utf-8");
  return response;
}

Response get_docs(const Call& call) {
  Response response = text_response(call, "text/html", docs_page());
  response.set("Content-Security-Policy", "default-src 'none'; style-src 'unsafe-inline'");
  return response;
}

}  // namespace spherule::api
