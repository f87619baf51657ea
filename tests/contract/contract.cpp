// SPDX-License-Identifier: GPL-3.0-or-later
#include "tests/contract/contract.h"

#include <yaml-cpp/yaml.h>

#include <algorithm>
#include <nlohmann/json.hpp>
#include <regex>
#include <set>

#include "api/routes.h"

namespace spherule::test {

namespace {

using Json = nlohmann::ordered_json;

Json from_yaml(const YAML::Node& node) {
  switch (node.Type()) {
    case YAML::NodeType::Map: {
      Json json = Json::object();
      for (const auto& pair : node) json[pair.first.as<std::string>()] = from_yaml(pair.second);
      return json;
    }
    case YAML::NodeType::Sequence: {
      Json json = Json::array();
      for (const auto& item : node) json.push_back(from_yaml(item));
      return json;
    }
    case YAML::NodeType::Scalar: {
      const auto text = node.as<std::string>();
      if (node.Tag() == "!") return text;  // quoted
      const Json parsed = Json::parse(text, nullptr, false);
      return parsed.is_primitive() && !parsed.is_discarded() ? parsed : Json(text);
    }
    default: return nullptr;
  }
}

const Json& document() {
  static const Json json = from_yaml(YAML::Load(std::string(api::contract())));
  return json;
}

const Json& resolved(const Json& json) {
  const Json* at = &json;
  while (at->contains("$ref")) at = &document().at(Json::json_pointer(at->at("$ref").get<std::string>().substr(1)));
  return *at;
}

bool is_type(const Json& value, const std::string& type) {
  if (type == "object") return value.is_object();
  if (type == "array") return value.is_array();
  if (type == "string") return value.is_string();
  if (type == "integer") return value.is_number_integer();
  if (type == "number") return value.is_number();
  if (type == "boolean") return value.is_boolean();
  return type == "null" && value.is_null();
}

// JSON Schema 2020-12, as far as the contract uses it; a keyword that is unknown here is itself a violation.
void check(const Json& value, const Json& schema, const std::string& where, std::vector<std::string>& wrong) {
  const auto complain = [&](const std::string& what) { wrong.push_back(where + ": " + what); };
  const bool is_null_allowed = value.is_null() && schema.contains("type") && schema["type"].is_array();
  for (const auto& [keyword, rule] : schema.items()) {
    if (keyword == "$ref") {
      check(value, resolved(schema), where, wrong);
    } else if (keyword == "type") {
      const bool fits = rule.is_array() ? std::ranges::any_of(rule, [&](const Json& t) { return is_type(value, t); })
                                        : is_type(value, rule);
      if (!fits) complain("is not of type " + rule.dump() + ": " + value.dump().substr(0, 80));
    } else if (is_null_allowed) {
      continue;
    } else if (keyword == "const") {
      if (value != rule) complain("is not " + rule.dump());
    } else if (keyword == "enum") {
      if (std::ranges::find(rule, value) == rule.end()) complain(value.dump() + " is not one of " + rule.dump());
    } else if (keyword == "pattern") {
      // Of anything but a string, a pattern says nothing.
      if (value.is_string() && !std::regex_search(value.get<std::string>(), std::regex(rule.get<std::string>()))) {
        complain(value.dump() + " does not match " + rule.dump());
      }
    } else if (keyword == "format") {
      static const std::regex time(R"(^\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\.\d{3}Z$)");
      if (rule == "date-time" && !std::regex_match(value.get<std::string>(), time)) complain("is not a time");
    } else if (keyword == "minimum") {
      if (value < rule) complain("is below " + rule.dump());
    } else if (keyword == "exclusiveMinimum") {
      if (value <= rule) complain("is not above " + rule.dump());
    } else if (keyword == "maximum") {
      if (value > rule) complain("is above " + rule.dump());
    } else if (keyword == "minItems") {
      if (value.size() < rule) complain("has too few items");
    } else if (keyword == "maxItems") {
      if (value.size() > rule) complain("has too many items");
    } else if (keyword == "items") {
      for (std::size_t i = 0; value.is_array() && i < value.size(); ++i) {
        check(value[i], rule, where + "/" + std::to_string(i), wrong);
      }
    } else if (keyword == "required") {
      for (const Json& name : rule) {
        if (!value.contains(name.get<std::string>())) complain("lacks " + name.dump());
      }
    } else if (keyword == "properties") {
      for (const auto& [name, sub] : rule.items()) {
        if (value.contains(name)) check(value[name], sub, where + "/" + name, wrong);
      }
    } else if (keyword == "additionalProperties") {
      for (const auto& [name, sub] : value.items()) {
        if (schema.contains("properties") && schema["properties"].contains(name)) continue;
        if (rule == false) complain("has the unlisted member " + name);
        if (rule.is_object()) check(sub, rule, where + "/" + name, wrong);
      }
    } else if (keyword == "oneOf") {
      const auto fits = std::ranges::count_if(rule, [&](const Json& option) {
        std::vector<std::string> none;
        check(value, option, where, none);
        return none.empty();
      });
      if (fits != 1) complain("fits " + std::to_string(fits) + " of the alternatives");
    } else if (keyword != "description" && keyword != "default") {
      complain("its schema uses " + keyword + ", which this test does not know");
    }
  }
}

bool fits_template(std::string_view pattern, std::string_view path) {
  while (!pattern.empty() && !path.empty()) {
    const std::string_view a = pattern.substr(0, std::min(pattern.find('/', 1), pattern.size()));
    const std::string_view b = path.substr(0, std::min(path.find('/', 1), path.size()));
    if (a != b && !(a.starts_with("/{") && b.size() > 1)) return false;
    pattern.remove_prefix(a.size());
    path.remove_prefix(b.size());
  }
  return pattern.empty() && path.empty();
}

bool is_method(const std::string& key) {
  static const std::set<std::string> methods = {"get", "post", "put", "patch", "delete", "head", "options"};
  return methods.contains(key);
}

std::string changed_case(std::string_view text, int by) {
  std::string out(text);
  for (char& c : out) c = static_cast<char>(c + by);
  return out;
}

// Adds the numbers in a schema of what `at` is.
void add_numbers(const Json& given, RequestNumber at, std::vector<RequestNumber>& all) {
  const Json& schema = resolved(given);
  const std::string type =
      schema.contains("type") && schema["type"].is_string() ? schema["type"].get<std::string>() : "";
  if (type == "number" || type == "integer") {
    at.whole = type == "integer";
    at.above = schema.contains("exclusiveMinimum");
    if (at.above || schema.contains("minimum")) at.least = schema[at.above ? "exclusiveMinimum" : "minimum"].dump();
    if (schema.contains("maximum")) at.most = schema["maximum"].dump();
    all.push_back(at);
  }
  if (schema.contains("items")) {
    at.items = schema.value("minItems", std::size_t{1});
    add_numbers(schema["items"], at, all);
  }
  for (const Json& alternative : schema.value("oneOf", Json::array())) {
    if (alternative.contains("properties")) {
      const Json& method = alternative["properties"]["method"];
      at.variant = method.contains("const") ? method["const"] : method["enum"][0];
      add_numbers(alternative, at, all);
    } else if (alternative.contains("type") || alternative.contains("items")) {
      add_numbers(alternative, at, all);
    }
  }
  if (!schema.contains("properties")) return;
  for (const auto& [name, property] : schema["properties"].items()) {
    RequestNumber inner = at;
    inner.name += "/" + name;
    add_numbers(property, inner, all);
  }
}

void check_examples(const Json& media, const std::string& where, std::vector<std::string>& wrong) {
  if (!media.contains("schema")) return;
  if (media.contains("example")) check(media["example"], media["schema"], where, wrong);
  if (!media.contains("examples")) return;
  for (const auto& [name, example] : media["examples"].items()) {
    check(example.at("value"), media["schema"], where + " " + name, wrong);
  }
}

}  // namespace

std::vector<std::pair<std::string, std::string>> contract_operations() {
  std::vector<std::pair<std::string, std::string>> operations;
  for (const auto& [path, item] : document().at("paths").items()) {
    for (const auto& [key, operation] : item.items()) {
      if (is_method(key)) operations.emplace_back(changed_case(key, -32), path);
    }
  }
  return operations;
}

std::set<std::string> listed_statuses(const std::string& method, const std::string& path) {
  std::set<std::string> statuses;
  for (const auto& [status, response] :
       document().at("paths").at(path).at(changed_case(method, 32))["responses"].items())
    statuses.insert(status);
  return statuses;
}

std::vector<RequestNumber> request_numbers() {
  std::vector<RequestNumber> all;
  for (const auto& [path, item] : document().at("paths").items()) {
    for (const auto& [key, operation] : item.items()) {
      if (!is_method(key)) continue;
      RequestNumber at;
      at.method = changed_case(key, -32), at.path = path;
      for (const Json* holder : {&item, &operation}) {
        for (const Json& given : holder->value("parameters", Json::array())) {
          const Json& parameter = resolved(given);
          RequestNumber number = at;
          number.in = parameter["in"], number.name = parameter["name"];
          add_numbers(parameter["schema"], number, all);
        }
      }
      if (!operation.contains("requestBody")) continue;
      for (const auto& [type, media] : operation["requestBody"]["content"].items()) {
        RequestNumber number = at;
        number.in = "body";
        if (media.contains("schema")) add_numbers(media["schema"], number, all);
      }
    }
  }
  return all;
}

std::string template_of(std::string_view path) {
  path = path.substr(0, path.find('?'));
  for (const auto& [pattern, item] : document().at("paths").items()) {
    if (fits_template(pattern, path)) return pattern;
  }
  return {};
}

std::vector<std::string> violations(std::string_view method, std::string_view path, int status,
                                    std::string_view content_type, std::string_view body) {
  std::vector<std::string> wrong;
  const std::string where = std::string(method) + " " + std::string(path) + " " + std::to_string(status);
  const std::string key = changed_case(method == "HEAD" ? "GET" : method, 32);
  const std::string pattern = template_of(path);
  if (pattern.empty() || !document()["paths"][pattern].contains(key)) {
    wrong.push_back(where + ": the contract has no such operation");
    return wrong;
  }
  const Json& responses = document()["paths"][pattern][key]["responses"];
  // What any request may be refused with stands under `default`; what is an operation's own must be listed.
  static const std::set<int> common = {401, 403, 408, 412, 414, 429, 431, 500, 503};
  const std::string listed =
      !responses.contains(std::to_string(status)) && common.contains(status) ? "default" : std::to_string(status);
  if (!responses.contains(listed)) {
    wrong.push_back(where + ": the contract does not list this status");
    return wrong;
  }
  const Json& response = resolved(responses[listed]);
  if (!response.contains("content")) return wrong;
  const std::string type(content_type.substr(0, content_type.find(';')));
  if (!response["content"].contains(type)) {
    wrong.push_back(where + ": the contract does not list the media type " + type);
    return wrong;
  }
  const Json& media = response["content"][type];
  if (method == "HEAD" || !media.contains("schema") || type.find("json") == std::string::npos) return wrong;
  const Json value = Json::parse(body, nullptr, false);
  if (value.is_discarded()) {
    wrong.push_back(where + ": the body is not JSON");
  } else {
    check(value, media["schema"], where, wrong);
  }
  return wrong;
}

std::vector<std::string> example_violations() {
  std::vector<std::string> wrong;
  for (const auto& [path, item] : document().at("paths").items()) {
    for (const auto& [key, operation] : item.items()) {
      if (!is_method(key)) continue;
      if (operation.contains("requestBody")) {
        for (const auto& [type, media] : operation["requestBody"]["content"].items()) {
          if (type == "application/json") check_examples(media, key + " " + path, wrong);
        }
      }
      for (const auto& [status, response] : operation["responses"].items()) {
        const Json& whole = resolved(response);
        if (!whole.contains("content")) continue;
        for (const auto& [type, media] : whole["content"].items()) check_examples(media, path + " " + status, wrong);
      }
    }
  }
  return wrong;
}

}  // namespace spherule::test
