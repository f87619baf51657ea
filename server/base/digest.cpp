// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/base/digest.h"

#include <openssl/evp.h>
#include <openssl/rand.h>

#include <algorithm>
#include <array>
#include <span>

#include "core/base/check.h"

namespace spherule::server {

namespace {

constexpr std::size_t id_digits = 32;

std::string hex_of(std::span<const unsigned char> bytes) {
  constexpr std::string_view digits = "0123456789abcdef";
  std::string text;
  text.reserve(2 * bytes.size());
  for (const unsigned char byte : bytes) text += {digits[byte >> 4], digits[byte & 15]};
  return text;
}

}  // namespace

struct Sha256::State {
  EVP_MD_CTX* context = EVP_MD_CTX_new();

  State() { SPHERULE_CHECK(context != nullptr); }
  ~State() { EVP_MD_CTX_free(context); }
  State(const State&) = delete;
  State& operator=(const State&) = delete;
};

Sha256::Sha256() : state_(std::make_unique<State>()) {
  SPHERULE_CHECK(EVP_DigestInit_ex(state_->context, EVP_sha256(), nullptr) == 1);
}
Sha256::~Sha256() = default;
Sha256::Sha256(Sha256&&) noexcept = default;
Sha256& Sha256::operator=(Sha256&&) noexcept = default;

void Sha256::update(std::string_view bytes) {
  SPHERULE_CHECK(EVP_DigestUpdate(state_->context, bytes.data(), bytes.size()) == 1);
}

std::string Sha256::hex() const {
  const State copy;  // finishing a copy leaves this one open for more
  std::array<unsigned char, 32> digest{};
  SPHERULE_CHECK(EVP_MD_CTX_copy_ex(copy.context, state_->context) == 1);
  SPHERULE_CHECK(EVP_DigestFinal_ex(copy.context, digest.data(), nullptr) == 1);
  return hex_of(digest);
}

std::string sha256_hex(std::string_view bytes) {
  Sha256 digest;
  digest.update(bytes);
  return digest.hex();
}

std::string content_id(std::string_view prefix, std::string_view bytes) {
  return std::string(prefix) + "_" + sha256_hex(bytes).substr(0, id_digits);
}

std::string random_id(std::string_view prefix) {
  std::array<unsigned char, id_digits / 2> bytes{};
  SPHERULE_CHECK(RAND_bytes(bytes.data(), static_cast<int>(bytes.size())) == 1);
  return std::string(prefix) + "_" + hex_of(bytes);
}

bool is_id(std::string_view prefix, std::string_view text) {
  if (text.size() != prefix.size() + 1 + id_digits || !text.starts_with(prefix) || text[prefix.size()] != '_')
    return false;
  const std::string_view digits = text.substr(prefix.size() + 1);
  return std::all_of(digits.begin(), digits.end(),
                     [](char c) { return (c >= '0' && c <= '9') || (c >= 'a' && c <= 'f'); });
}

}  // namespace spherule::server
