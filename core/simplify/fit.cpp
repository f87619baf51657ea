// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/simplify/fit.h"

#include <algorithm>
#include <cstring>
#include <numbers>

#include "core/base/elementary.h"

namespace spherule::detail {

namespace {

// The sum of bytes of 0, 1 or 2, eight at a time. Reads up to seven bytes beyond.
std::uint64_t sum_of_bytes(const std::uint8_t* bytes, std::size_t count) {
  const auto word_at = [&](std::size_t i) {
    std::uint64_t word;
    std::memcpy(&word, bytes + i, sizeof word);
    return word;
  };
  const auto sum_of_lanes = [](std::uint64_t lanes) {
    const std::uint64_t pairs = (lanes & 0x00ff00ff00ff00ffU) + (lanes >> 8 & 0x00ff00ff00ff00ffU);
    return pairs * 0x0001000100010001U >> 48;
  };
  constexpr std::size_t most = 127 * 8;  // before a lane of the sum could overflow
  std::uint64_t sum = 0;
  for (std::size_t begin = 0; begin < count; begin += most) {
    const std::size_t end = std::min(count, begin + most);
    std::uint64_t lanes = 0;
    std::size_t i = begin;
    for (; i + 8 <= end; i += 8) lanes += word_at(i);
    sum += sum_of_lanes(lanes);
    if (i < end) sum += sum_of_lanes(word_at(i) & ~(~std::uint64_t{0} << 8 * (end - i)));
  }
  return sum;
}

}  // namespace

Fit::Fit(const SampledObject& object, const Context& context) : frame_(object, context), count_(frame_.value.size()) {
  for (const std::int8_t value : frame_.value) open_.push_back(static_cast<std::uint8_t>(1 + value));
  open_.resize(open_.size() + sizeof(std::uint64_t), 1);
}

void Fit::change(const Sphere& ball, int by) {
  visit_rows(frame_.spacing, ball, frame_.window, [&](std::int32_t j, std::int32_t k, Run run) {
    const std::size_t row = frame_.at(run.begin, j, k), end = row + static_cast<std::size_t>(run.end - run.begin);
    for (std::size_t s = row; s < end; ++s) {
      count_[s] = static_cast<std::uint16_t>(count_[s] + by);
      open_[s] = count_[s] == 0 ? static_cast<std::uint8_t>(1 + frame_.value[s]) : std::uint8_t{1};
    }
  });
}

std::int64_t Fit::gain(const Sphere& ball) const {
  std::int64_t sum = 0, samples = 0;
  visit_rows(frame_.spacing, ball, frame_.window, [&](std::int32_t j, std::int32_t k, Run run) {
    const auto length = static_cast<std::size_t>(run.end - run.begin);
    sum += static_cast<std::int64_t>(sum_of_bytes(open_.data() + frame_.at(run.begin, j, k), length)) -
           static_cast<std::int64_t>(length);
    samples += run.end - run.begin;
  });
  bool within = true;
  for (int a = 0; a < 3; ++a) {
    const auto axis = static_cast<std::size_t>(a);
    within &= ball.centre[a] - ball.radius > frame_.spacing[a] * (frame_.window.begin[axis] - 1) &&
              ball.centre[a] + ball.radius < frame_.spacing[a] * frame_.window.end[axis];
  }
  if (frame_.border_open || within) return sum;
  // Beyond the window all is outside; how many samples the ball has there, its volume tells well enough.
  const double all = 4 * std::numbers::pi / 3 * elementary::pow(ball.radius / frame_.voxel, 3);
  return sum - std::max<std::int64_t>(static_cast<std::int64_t>(all) - samples, 0);
}

}  // namespace spherule::detail
